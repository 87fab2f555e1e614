"""The linear solve of the implicit leapfrog, as a template (Jinja).

It runs after each pass and finds the change of velocity dv_i of each point from

    A_{i,i-2} dv_{i-2} + ... + A_{i,i+2} dv_{i+2} = m_i dt a_i,

where blocks of two by two couple point i to two neighbours on each side. With the
matrix of `implicit_leapfrog.py`, B_i of hinge i, e_i of the segment that starts at
point i, and S_i the averaged stiffness of that segment and both its hinges,

    A_{i,i}   = m_i + S_{i-1} + S_i + B_i (e_{i-1} e_i' + e_i e_{i-1}')
    A_{i,i+1} = -S_i - B_i e_{i-1} e_i' - B_{i+1} e_i e_{i+1}'
    A_{i,i+2} = B_{i+1} e_i e_{i+1}'.

Block elimination from the grasp to the tip (Golub and Van Loan, Matrix Computations,
4.5) leaves, with D_i the eliminated diagonal block,

    D_i  = A_{i,i} - U_{i-1}' Q_{i-1} - B_{i-1}^2 (e_{i-2} . z_{i-2}) e_{i-1} e_{i-1}'
    U_i  = A_{i,i+1} - B_i U_{i-1}' z_{i-1} e_i'
    r_i  = m_i dt a_i - U_{i-1}' y_{i-1} - B_{i-1} (e_{i-2} . y_{i-2}) e_{i-1}
    Q_i  = D_i^-1 U_i,  z_i = D_i^-1 e_i,  y_i = D_i^-1 r_i,

and substitution back from the tip

    dv_i = y_i - Q_i dv_{i+1} - B_{i+1} (e_{i+1} . dv_{i+2}) z_i.

Rows TURN contain e. Rows DV contain first a, then y, then dv. U, Q, z and DV of the
grasp are zero. Repeated text is a macro: functions took 1.8 s more to compile.
"""

BLOCK_SOLVE = """\
{% macro eliminate() %}
# softening: B_{i-1}^2 (e_{i-2} . z_{i-2}). impulse_before: B_{i-1} (e_{i-2} . y_{i-2}).
u11 = rows[U11 + before]
u12 = rows[U12 + before]
u21 = rows[U21 + before]
u22 = rows[U22 + before]
bx = rows[TURN_X + before]
by = rows[TURN_Y + before]
impulse = rows[MASS + point] * dt
rx = impulse * rows[DVX + point] - u11 * rows[DVX + before] - u21 * rows[DVY + before] - impulse_before * bx
ry = impulse * rows[DVY + point] - u12 * rows[DVX + before] - u22 * rows[DVY + before] - impulse_before * by
# D
ex = rows[TURN_X + point]
ey = rows[TURN_Y + point]
bend = rows[BENDING + point]
d11 = rows[MASS + point] + rows[S11 + before] + rows[S11 + point] + 2.0 * bend * bx * ex - softening * bx * bx
d12 = rows[S12 + before] + rows[S12 + point] + bend * (bx * ey + by * ex) - softening * bx * by
d22 = rows[MASS + point] + rows[S22 + before] + rows[S22 + point] + 2.0 * bend * by * ey - softening * by * by
d11 -= u11 * rows[Q11 + before] + u21 * rows[Q21 + before]
d12 -= u11 * rows[Q12 + before] + u21 * rows[Q22 + before]
d22 -= u12 * rows[Q12 + before] + u22 * rows[Q22 + before]
# U = -S - g e' - e h', with g = B_i (e_{i-1} + U_{i-1}' z_{i-1}) and h = B_{i+1} e_{i+1}
gx = bend * (bx + u11 * rows[ZX + before] + u21 * rows[ZY + before])
gy = bend * (by + u12 * rows[ZX + before] + u22 * rows[ZY + before])
hx = rows[BENDING + point + NEXT] * rows[TURN_X + point + NEXT]
hy = rows[BENDING + point + NEXT] * rows[TURN_Y + point + NEXT]
u11 = -rows[S11 + point] - gx * ex - hx * ex
u12 = -rows[S12 + point] - gx * ey - hy * ex
u21 = -rows[S12 + point] - gy * ex - hx * ey
u22 = -rows[S22 + point] - gy * ey - hy * ey
# Q, z and y, by the adjugate of D
inverse = 1.0 / (d11 * d22 - d12 * d12)
d11 *= inverse
d12 *= inverse
d22 *= inverse
rows[U11 + point] = u11
rows[U12 + point] = u12
rows[U21 + point] = u21
rows[U22 + point] = u22
rows[Q11 + point] = d22 * u11 - d12 * u21
rows[Q12 + point] = d22 * u12 - d12 * u22
rows[Q21 + point] = d11 * u21 - d12 * u11
rows[Q22 + point] = d11 * u22 - d12 * u12
rows[ZX + point] = d22 * ex - d12 * ey
rows[ZY + point] = d11 * ey - d12 * ex
rows[DVX + point] = d22 * rx - d12 * ry
rows[DVY + point] = d11 * ry - d12 * rx
{% endmacro %}
# Phase 6: the solve. S and e of each segment.
for i in range(n - ONE):
    for lane in range(LANES):
        segment = i * NEXT + lane
        tx = rows[TANGENT_X + segment]
        ty = rows[TANGENT_Y + segment]
        inverse = rows[INVERSE_LENGTH + segment]
        pull = rows[TENSION + segment] if rows[TENSION + segment] > 0.0 else 0.0
        along = rows[AXIAL + lane]
        hinges = rows[BENDING + segment] + rows[BENDING + segment + NEXT]
        across = ({{ integrator.stiffness_weight }} * dt * dt * pull + hinges * inverse) * inverse
        rows[TURN_X + segment] = -ty * inverse
        rows[TURN_Y + segment] = tx * inverse
        rows[S11 + segment] = along * tx * tx + across * ty * ty
        rows[S12 + segment] = (along - across) * tx * ty
        rows[S22 + segment] = along * ty * ty + across * tx * tx
# Elimination from the grasp to the tip. The first free point is separate: no point is two before it, and the vector
# units need rows at distances known at compile time.
for lane in range(LANES):
    point = NEXT + lane
    before = lane
    softening = 0.0
    impulse_before = 0.0
    {{ eliminate() | indent }}
for i in range(TWO, n):
    for lane in range(LANES):
        point = i * NEXT + lane
        before = point - NEXT
        second = before - NEXT
        ex = rows[TURN_X + second]
        ey = rows[TURN_Y + second]
        bend = rows[BENDING + before]
        softening = bend * bend * (ex * rows[ZX + second] + ey * rows[ZY + second])
        impulse_before = bend * (ex * rows[DVX + second] + ey * rows[DVY + second])
        {{ eliminate() | indent(8) }}
# Substitution from the tip: dv, velocity and position of each point.
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
