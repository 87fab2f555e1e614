"""The step loop for one set of effects and one integrator, as a template.

It is a Jinja template of a Python module for Numba. `kernel_codegen.generate_source`
fills it in with

- `laws`: the laws of the effects as text (`law_source.LawSource`),
- `integrator`: the time step (`integrators.Integrator`),
- `solve`: what the integrator does after each pass,
- `rows`: number of each row of a mass point, by name,
- `lanes`: candidates side by side.

README.md in this folder has the equations.

Each pass goes along the string once. The offset `ahead` is that of the segment to
measure and of the point at its start. `point` = ahead - NEXT is that of the segment
whose forces are then known, and of the point to move.

The work in one lane is a function, which Numba lowers once and inlines at each call.
Only `run` has loops over lanes: a function with loops would be optimised by itself, and
again where it is inlined.
"""

STEP_LOOP = '''\
{% set stages = integrator.stage_times | length %}
{% macro per_segment() %}
{% if laws.per_segment %}
per_segment = {{ laws.per_segment }}
{%- endif %}
{% endmacro %}
{% macro vector_sum(slot, name) %}
{% for effect in laws.effects_with(slot) %}
{{ name }}{{ loop.index0 }}x, {{ name }}{{ loop.index0 }}y = {{ laws.call(effect, slot) }}
{% endfor %}
{% for axis in "xy" %}
{% set count = laws.effects_with(slot) | length %}
{{ name }}{{ axis }} =
{%- for i in range(count) %}{{ " +" if i }} {{ name }}{{ i }}{{ axis }}{% else %} 0.0{% endfor %}

{% endfor %}
{% endmacro %}
{# Only the first pass of a step stores the memory. #}
{% macro unless_rehearsal(other) %}{% if stages > 1 %} if stage == 0 else {{ other }}{% endif %}{% endmacro %}
{% macro memory_update(slot) %}
{% if laws.effects_with(slot) %}
change = curvature - rows[LAST_CURVATURE + ahead]
duration = dt{{ unless_rehearsal("dt * STAGE_TIMES[stage]") }}
{% for effect in laws.effects_with(slot) %}
{% set row = "rows[MEMORY" ~ loop.index0 ~ " + ahead]" %}
memory_{{ loop.index0 }} = {{ laws.call(effect, slot, memory=row) }}
{{ row }} = memory_{{ loop.index0 }}{{ unless_rehearsal(row) }}
{% endfor %}
rows[LAST_CURVATURE + ahead] = curvature{{ unless_rehearsal("rows[LAST_CURVATURE + ahead]") }}
{%- endif %}
{% endmacro %}
{% macro memory_moments(slot) %}
{% for effect in laws.effects_with(slot) %} + {{ laws.call(effect, slot, memory="memory_" ~ loop.index0) }}{% endfor %}
{% endmacro %}
"""A step loop, generated from step_loop_template.py. Not to be edited."""
from __future__ import annotations

import numpy as np
from numba import njit

BARE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # only this module calls inlined functions
LAW = {"error_model": "numpy", "fastmath": {"contract"}, "boundscheck": False, "forceinline": True, **BARE}
STAGE_TIMES = {{ integrator.stage_times }}
LANES = np.uintp({{ lanes }})
ONE = np.uintp(1)
TWO = np.uintp(2)
# Rows: distances in the buffer from the first row of a point.
{% for name, number in rows.items() %}
{{ name }} = np.uintp({{ number * lanes }})
{% endfor %}
NEXT = np.uintp({{ rows | length * lanes }})  # distance from a point to the next
# Coefficients of the hand's cubic in a tick, by power of the elapsed fraction.
{% for quantity in ("X", "Y", "ANGLE") %}
{% set first = loop.index0 * 4 %}
{% for power in range(4) %}
HAND_{{ quantity }}{{ power }} = np.uintp({{ (first + power) * lanes }})
{% endfor %}
{% endfor %}


# Laws of the effects.
{% for definition in laws.definitions() %}
@njit(**LAW)
{{ definition }}


{% endfor %}
{{ integrator.turn_source }}


# Phase 1: the hand. Pose and rate of the grasp at a fraction of a tick.
@njit(**LAW)
def move_hand(rows, hand, lane, fraction, tick):
    x1, x2, x3 = hand[HAND_X1 + lane], hand[HAND_X2 + lane], hand[HAND_X3 + lane]
    y1, y2, y3 = hand[HAND_Y1 + lane], hand[HAND_Y2 + lane], hand[HAND_Y3 + lane]
    a1, a2, a3 = hand[HAND_ANGLE1 + lane], hand[HAND_ANGLE2 + lane], hand[HAND_ANGLE3 + lane]
    rows[X + lane] = hand[HAND_X0 + lane] + fraction * (x1 + fraction * (x2 + fraction * x3))
    rows[Y + lane] = hand[HAND_Y0 + lane] + fraction * (y1 + fraction * (y2 + fraction * y3))
    rows[HAND_ANGLE + lane] = hand[HAND_ANGLE0 + lane] + fraction * (a1 + fraction * (a2 + fraction * a3))
    rows[VX + lane] = (x1 + fraction * (2.0 * x2 + 3.0 * fraction * x3)) / tick
    rows[VY + lane] = (y1 + fraction * (2.0 * y2 + 3.0 * fraction * y3)) / tick
    rows[HAND_RATE + lane] = (a1 + fraction * (2.0 * a2 + 3.0 * fraction * a3)) / tick


# Phase 2: the segment ahead. Direction, turn since the last pass, and tension.
@njit(**LAW)
def measure_segment(rows, values, lane, ahead, per_segment, s_middle):
    {{ per_segment() | indent }}
    ex = rows[X + ahead + NEXT] - rows[X + ahead]
    ey = rows[Y + ahead + NEXT] - rows[Y + ahead]
    cross = rows[SEGMENT_X + ahead] * ey - rows[SEGMENT_Y + ahead] * ex
    dot = rows[SEGMENT_X + ahead] * ex + rows[SEGMENT_Y + ahead] * ey
    angle = rows[ANGLE + ahead] + turned(cross, dot)
    rows[SEGMENT_X + ahead] = ex
    rows[SEGMENT_Y + ahead] = ey
    wx = rows[VX + ahead + NEXT] - rows[VX + ahead]
    wy = rows[VY + ahead + NEXT] - rows[VY + ahead]
    size = np.sqrt(ex * ex + ey * ey)
    inverse = 1.0 / size
    tx = ex * inverse
    ty = ey * inverse
    omega = (tx * wy - ty * wx) * inverse
    stretch = size * per_segment - 1.0
    rate = (tx * wx + ty * wy) * per_segment
    rows[ANGLE + ahead] = angle
    rows[TANGENT_X + ahead] = tx
    rows[TANGENT_Y + ahead] = ty
    rows[INVERSE_LENGTH + ahead] = inverse
    rows[TURN_RATE + ahead] = omega
    rows[TENSION + ahead] = {{ laws.sum_of_laws("tension") }}


# Phase 3: the hinges. Moment at the grasp, and between two segments.
@njit(**LAW)
def bend_grasp(rows, values, lane, ahead, dt, stage):
    {% set rest_angle = "rows[GRASP_REST_ANGLE + lane]" if laws.effects_with("rest_curvature") else "0.0" %}
    curvature = rows[ANGLE + ahead] - rows[HAND_ANGLE + lane] - {{ rest_angle }}
    bend = rows[TURN_RATE + ahead] - rows[HAND_RATE + lane]
    {{ memory_update("grasp_memory") | indent }}
    rows[MOMENT + ahead] = {{ laws.sum_of_laws("grasp_moment") }}{{ memory_moments("grasp_memory_moment") }}


@njit(**LAW)
def bend_hinge(rows, values, lane, ahead, per_segment, s_hinge, string_length, dt, stage):
    {{ per_segment() | indent }}
    turn = rows[ANGLE + ahead] - rows[ANGLE + ahead - NEXT]
    turn_rate = rows[TURN_RATE + ahead] - rows[TURN_RATE + ahead - NEXT]
    curvature = turn * per_segment - ({{ laws.sum_of_laws("rest_curvature") }})
    bend = turn_rate * per_segment
    {{ memory_update("hinge_memory") | indent }}
    {% if laws.effects_with("hinge_stiffness") %}
    hinge_stiffness = {{ laws.sum_of_laws("hinge_stiffness", curvature="curvature") }}
    {% if "hinge_stiffness" in integrator.averaged_slots %}
    # A hardening moment rises more steeply than moment / curvature, so the step averages a stiffness further along.
    {% set most = "abs(curvature) + " ~ max_bend_per_step %}
    steepest = max({{ laws.sum_of_laws("hinge_stiffness", curvature=most) }}, 0.0)
    rows[BENDING + ahead] = rows[LINEAR_BENDING + ahead] + (0.5 * dt * dt * steepest) * per_segment
    {% endif %}
    {% endif %}
    {% set stiff_moment = " + hinge_stiffness * curvature" if laws.effects_with("hinge_stiffness") %}
    rows[MOMENT + ahead] = {{ laws.sum_of_laws("moment") }}{{ stiff_moment }}{{ memory_moments("hinge_memory_moment") }}


# Phase 4: the forces of the segment behind, from its tension and the moments at its ends.
@njit(**LAW)
def force_of_segment(rows, point):
    shear = (rows[MOMENT + point + NEXT] - rows[MOMENT + point]) * rows[INVERSE_LENGTH + point]
    fx = -rows[TENSION + point] * rows[TANGENT_X + point] - shear * rows[TANGENT_Y + point]
    fy = -rows[TENSION + point] * rows[TANGENT_Y + point] + shear * rows[TANGENT_X + point]
    rows[FORCE_X + point] = fx
    rows[FORCE_Y + point] = fy
    return fx, fy


# Phase 5: the integrator. Acceleration of the point behind by both its segments and by loads, and its new position.
@njit(**LAW)
def move_point(rows, values, lane, point, fx, fy, s_point, dt, t, stage):
    px = rows[X + point]
    py = rows[Y + point]
    {{ integrator.velocity_source | indent }}
    lx = 0.5 * (rows[TANGENT_X + point - NEXT] + rows[TANGENT_X + point])
    ly = 0.5 * (rows[TANGENT_Y + point - NEXT] + rows[TANGENT_Y + point])
    {{ vector_sum("flow", "air") | indent }}
    {{ vector_sum("load", "load") | indent }}
    {{ vector_sum("acceleration", "fall") | indent }}
    {% set length_per_mass = "rows[LENGTH_PER_MASS + point]" if laws.masses_vary else "1.0" %}
    ax = (rows[FORCE_X + point - NEXT] - fx) * rows[INVERSE_MASS + point] + {{ length_per_mass }} * loadx + fallx
    ay = (rows[FORCE_Y + point - NEXT] - fy) * rows[INVERSE_MASS + point] + {{ length_per_mass }} * loady + fally
    {{ integrator.update_source | indent }}
    rows[X + point] = px
    rows[Y + point] = py
    rows[VX + point] = qx
    rows[VY + point] = qy


@njit(**LAW)
def record(rows, n, first, tick_number, out, alive):
    # Store the positions of the block's candidates at a tick. A lane whose tip is not within a kilometre is rejected.
    # Returns whether any lane is left.
    for lane in range(LANES):
        if first + lane < np.uintp(out.shape[0]):
            for i in range(n):
                out[first + lane, tick_number, i, 0] = rows[X + i * NEXT + lane]
                out[first + lane, tick_number, i, 1] = rows[Y + i * NEXT + lane]
    any_alive = False
    for lane in range(LANES):
        size = abs(rows[X + (n - ONE) * NEXT + lane]) + abs(rows[Y + (n - ONE) * NEXT + lane])
        alive[lane] = alive[lane] and size < 1e3
        any_alive |= alive[lane]
    return any_alive


@njit(nogil=True, error_model="numpy", fastmath={"contract"}, boundscheck=False, cache=True)
def run(first, last, buffers, values, hands, hands_per_block, points, length, steps, tick, start, out, alive):
    # Blocks first to last - 1. buffers (blocks, size), values (blocks, parameters * lanes), hands (ticks, blocks or 1,
    # 12 * lanes), out (candidates, ticks + 1, n, 2), alive (blocks, lanes).
    n = np.uintp(points)
    dt = tick / steps
    per_segment = 1.0 / length
    string_length = (float(n) - 1.0) * length
    for block in range(first, last):
        rows = buffers[block]
        parameters = values[block]
        candidate = np.uintp(block) * LANES
        record(rows, n, candidate, 0, out, alive[block])
        for tick_number in range(hands.shape[0]):
            hand = hands[tick_number, block * hands_per_block]
            for step in range(steps):
                for stage in range(len(STAGE_TIMES)):
                    fraction = (step + STAGE_TIMES[stage]) / steps
                    t = start + (tick_number + fraction) * tick
                    for lane in range(LANES):
                        move_hand(rows, hand, lane, fraction, tick)
                    # One pass from the grasp to the tip. A point moves when both its segments are measured.
                    for lane in range(LANES):
                        measure_segment(rows, parameters, lane, lane, per_segment, 0.5 * length)
                        bend_grasp(rows, parameters, lane, lane, dt, stage)
                    for lane in range(LANES):
                        ahead = NEXT + lane
                        measure_segment(rows, parameters, lane, ahead, per_segment, 1.5 * length)
                        bend_hinge(rows, parameters, lane, ahead, per_segment, length, string_length, dt, stage)
                        force_of_segment(rows, lane)
                    for i in range(TWO, n - ONE):
                        s_middle = (float(i) + 0.5) * length
                        s_hinge = float(i) * length
                        s_point = (float(i) - 1.0) * length
                        for lane in range(LANES):
                            ahead = i * NEXT + lane
                            point = ahead - NEXT
                            measure_segment(rows, parameters, lane, ahead, per_segment, s_middle)
                            bend_hinge(rows, parameters, lane, ahead, per_segment, s_hinge, string_length, dt, stage)
                            fx, fy = force_of_segment(rows, point)
                            move_point(rows, parameters, lane, point, fx, fy, s_point, dt, t, stage)
                    # The last two points. The moment at the tip stays 0, and no segment lies beyond it.
                    for lane in range(LANES):
                        tip = (n - ONE) * NEXT + lane
                        point = tip - NEXT
                        fx, fy = force_of_segment(rows, point)
                        move_point(rows, parameters, lane, point, fx, fy, (float(n) - 2.0) * length, dt, t, stage)
                        rows[TANGENT_X + tip] = rows[TANGENT_X + point]
                        rows[TANGENT_Y + tip] = rows[TANGENT_Y + point]
                        move_point(rows, parameters, lane, tip, 0.0, 0.0, string_length, dt, t, stage)
                    {{ solve | indent(20) }}
            for lane in range(LANES):
                move_hand(rows, hand, lane, 1.0, tick)
            if not record(rows, n, candidate, tick_number + 1, out, alive[block]):
                break
'''
