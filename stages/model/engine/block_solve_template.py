"""The solve of the implicit leapfrog, as a template (Jinja).

Its text runs after each pass.

`implicit_leapfrog.py` derives the matrix, which couples a point to two neighbours on
each side. It is eliminated from the grasp to the tip in blocks of two by two, then
solved backwards. Rows, for each point: U the block to the next point, Q = D^-1 U and z
= D^-1 e with D the eliminated diagonal block, and DV the change of velocity, which
holds the acceleration first. U, Q, z and DV of the grasp are zero.
"""

BLOCK_SOLVE = """\
{% macro eliminate() %}
# what the two points before leave here
u11 = rows[U11 + point]
u12 = rows[U12 + point]
u21 = rows[U21 + point]
u22 = rows[U22 + point]
bx = rows[TURN_X + point]
by = rows[TURN_Y + point]
impulse = rows[MASS + ahead] * dt
rx = impulse * rows[DVX + ahead] - u11 * rows[DVX + point] - u21 * rows[DVY + point] - spin * bx
ry = impulse * rows[DVY + ahead] - u12 * rows[DVX + point] - u22 * rows[DVY + point] - spin * by
# the diagonal block
ex = rows[TURN_X + ahead]
ey = rows[TURN_Y + ahead]
bend = rows[BENDING + ahead]
d11 = rows[MASS + ahead] + rows[S11 + point] + rows[S11 + ahead] + 2.0 * bend * bx * ex - turn * bx * bx
d12 = rows[S12 + point] + rows[S12 + ahead] + bend * (bx * ey + by * ex) - turn * bx * by
d22 = rows[MASS + ahead] + rows[S22 + point] + rows[S22 + ahead] + 2.0 * bend * by * ey - turn * by * by
d11 -= u11 * rows[Q11 + point] + u21 * rows[Q21 + point]
d12 -= u11 * rows[Q12 + point] + u21 * rows[Q22 + point]
d22 -= u12 * rows[Q12 + point] + u22 * rows[Q22 + point]
# the block to the next point
bx = bend * (bx + u11 * rows[ZX + point] + u21 * rows[ZY + point])
by = bend * (by + u12 * rows[ZX + point] + u22 * rows[ZY + point])
cx = rows[BENDING + ahead + NEXT] * rows[TURN_X + ahead + NEXT]
cy = rows[BENDING + ahead + NEXT] * rows[TURN_Y + ahead + NEXT]
u11 = -rows[S11 + ahead] - bx * ex - cx * ex
u12 = -rows[S12 + ahead] - bx * ey - cy * ex
u21 = -rows[S12 + ahead] - by * ex - cx * ey
u22 = -rows[S22 + ahead] - by * ey - cy * ey
inverse = 1.0 / (d11 * d22 - d12 * d12)
d11 *= inverse
d12 *= inverse
d22 *= inverse
rows[U11 + ahead] = u11
rows[U12 + ahead] = u12
rows[U21 + ahead] = u21
rows[U22 + ahead] = u22
rows[Q11 + ahead] = d22 * u11 - d12 * u21
rows[Q12 + ahead] = d22 * u12 - d12 * u22
rows[Q21 + ahead] = d11 * u21 - d12 * u11
rows[Q22 + ahead] = d11 * u22 - d12 * u12
rows[ZX + ahead] = d22 * ex - d12 * ey
rows[ZY + ahead] = d11 * ey - d12 * ex
rows[DVX + ahead] = d22 * rx - d12 * ry
rows[DVY + ahead] = d11 * ry - d12 * rx
{% endmacro %}
# Phase 6: the solve. The averaged stiffness of each segment, S, and how its angle turns with its end, e.
for i in range(n - ONE):
    for lane in range(LANES):
        ahead = i * NEXT + lane
        tx = rows[TANGENT_X + ahead]
        ty = rows[TANGENT_Y + ahead]
        inverse = rows[INVERSE_LENGTH + ahead]
        pull = rows[TENSION + ahead] if rows[TENSION + ahead] > 0.0 else 0.0
        along = rows[AXIAL + lane]
        across = (0.25 * dt * dt * pull + (rows[BENDING + ahead] + rows[BENDING + ahead + NEXT]) * inverse) * inverse
        rows[TURN_X + ahead] = -ty * inverse
        rows[TURN_Y + ahead] = tx * inverse
        rows[S11 + ahead] = along * tx * tx + across * ty * ty
        rows[S12 + ahead] = (along - across) * tx * ty
        rows[S22 + ahead] = along * ty * ty + across * tx * tx
# Elimination from the grasp to the tip. The first free point is taken by itself, for nothing is two points before it,
# and the vector units need rows at distances that are known when compiling.
for lane in range(LANES):
    ahead = NEXT + lane
    point = lane
    turn = 0.0
    spin = 0.0
    {{ eliminate() | indent }}
for i in range(TWO, n):
    for lane in range(LANES):
        ahead = i * NEXT + lane
        point = ahead - NEXT
        # what the second point before leaves here
        ex = rows[TURN_X + point - NEXT]
        ey = rows[TURN_Y + point - NEXT]
        bend = rows[BENDING + point]
        turn = bend * bend * (ex * rows[ZX + point - NEXT] + ey * rows[ZY + point - NEXT])
        spin = bend * (ex * rows[DVX + point - NEXT] + ey * rows[DVY + point - NEXT])
        {{ eliminate() | indent(8) }}
# Back from the tip: the changes of all velocities, and with them all positions.
for i in range(ONE, n):
    for lane in range(LANES):
        point = (n - i) * NEXT + lane
        ahead = point + NEXT
        turn = rows[BENDING + ahead] * (
            rows[TURN_X + ahead] * rows[DVX + ahead + NEXT] + rows[TURN_Y + ahead] * rows[DVY + ahead + NEXT]
        )
        nextx = rows[DVX + ahead]
        nexty = rows[DVY + ahead]
        dvx = rows[DVX + point] - rows[Q11 + point] * nextx - rows[Q12 + point] * nexty - turn * rows[ZX + point]
        dvy = rows[DVY + point] - rows[Q21 + point] * nextx - rows[Q22 + point] * nexty - turn * rows[ZY + point]
        vx = rows[VX + point] + dvx
        vy = rows[VY + point] + dvy
        rows[DVX + point] = dvx
        rows[DVY + point] = dvy
        rows[VX + point] = vx
        rows[VY + point] = vy
        rows[X + point] += dt * vx
        rows[Y + point] += dt * vy
"""
