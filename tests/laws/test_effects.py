"""Every effect of the library keeps its declared properties.

They are invariants, zero at the start, units, gradient, description and plot.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import TRUTH, swing
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from stringcast.data.artifacts import JOINTS
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.camera import Camera
from stringcast.stages.model.effect import StringEffect
from stringcast.stages.model.engine.law_slots import SLOTS, law_arguments
from stringcast.stages.model.engine.stability import steps_per_tick
from stringcast.stages.model.hand import resample_joint_motion
from stringcast.stages.model.library import effects_by_name
from stringcast.stages.model.model import Model
from stringcast.stages.model.parameter import Parameter
from stringcast.stages.model.string import PAPER_EFFECTS, String

LIBRARY = effects_by_name()
NAMES = [
    "wind",
    "tip_mass",
    "density_taper",
    "rest_curvature",
    "nonlinear_bending",
    "maxwell_slip",
    "dahl_friction",
    "standard_linear_solid",
    "clamp",
    "grasp_play",
    "anisotropic_drag",
    "resolution",
    "contact",
    "box_contact",
    "equal_points",
    "gravity_direction",
    "arm_lag",
    "joint_gain",
    "backlash",
    "grasp_angle",
    "grasp_slip",
    "time_offset",
    "clock_drift",
    "camera_rotation",
    "camera_offset",
    "pixel_scale",
    "lens_distortion",
    "rolling_shutter",
]
ADDED = [e for e in LIBRARY.values() if e not in PAPER_EFFECTS and e.parameters]
PAPER = {p.name: p for e in PAPER_EFFECTS for p in e.parameters}
BASE_VALUES = TRUTH | {"axial_stiffness": 2e5, "grasp_stiffness": 3.0}
# Values with which an effect acts: a slip during the motion, a floor below the resting
# string, a wall, and a corner of a box in the way of the string.
FLOOR = {
    "contact.stiffness": 3e3,
    "contact.height": -0.3,
    "contact.friction": 0.2,
    "contact.loss": 0.1,
}
ACTING_VALUES = {"grasp_slip.onset": {"grasp_slip.speed": 0.05}}
ACTING_VALUES |= {
    "grasp_slip.duration": {
        "grasp_slip.speed": 0.05,
        "grasp_slip.onset": 0.1,
        "grasp_slip.duration": 0.2,
    }
}
ACTING_VALUES |= {
    "rolling_shutter.stamped": {
        "rolling_shutter.readout": 5e-3,
        "rolling_shutter.stamped": 0.5,
    }
}
ACTING_VALUES |= {
    f"contact.{name}": FLOOR for name in ("stiffness", "height", "tilt", "friction")
}
ACTING_VALUES |= {
    "contact.loss": FLOOR | {"contact.tilt": np.pi / 2, "contact.height": -0.75}
}
CORNER = {
    "box_contact.centre_x": 0.0,
    "box_contact.centre_y": 0.85,
    "box_contact.width": 0.2,
    "box_contact.height": 0.2,
    "box_contact.stiffness": 3e3,
    "box_contact.friction": 0.2,
    "box_contact.loss": 0.1,
}
ACTING_VALUES |= dict.fromkeys(CORNER, CORNER)
ACTING_VALUES |= {
    f"{name}.slip": {f"{name}.cap": 2e-3} for name in ("maxwell_slip", "dahl_friction")
}
ACTING_VALUES |= {"grasp_play.slip": {"grasp_play.cap": 0.02}}
ACTING_VALUES |= {
    "standard_linear_solid.relaxation": {"standard_linear_solid.stiffness": 1e-3}
}
LAWS = [(effect, law) for effect in LIBRARY.values() for law in effect.laws()]
INVARIANTS = [
    (effect, invariant)
    for effect in LIBRARY.values()
    for invariant in effect.invariants
]
SAMPLES = 40
CAMERA = Camera(640, 480, 300.0, (200.0, 300.0), 200.0)


def draw_values(
    parameter: Parameter, rng: np.random.Generator, size: int
) -> np.ndarray:
    return parameter.value(rng.uniform(0, 1, size))


def arguments_of_string(effect, rng):
    """Sample all arguments that a law can take.

    They are its slot's arguments, the paper's parameters, and its own.
    """
    sizes = {
        "curvature": 30.0,
        "rate": 300.0,
        "x": 1.0,
        "y": 1.0,
        "s": 0.1,
        "t": 1.0,
        "dt": 1e-3,
    }
    known = {
        name: sizes.get(name, 3.0) * rng.normal(size=SAMPLES)
        for slot in SLOTS.values()
        for name in slot.arguments
    }
    turn = rng.uniform(0, 2 * np.pi, SAMPLES)
    known |= {"tx": np.cos(turn), "ty": np.sin(turn), "length": np.full(SAMPLES, 0.3)}
    own = {p.name: draw_values(p, rng, SAMPLES) for p in effect.parameters}
    known |= {name: draw_values(p, rng, SAMPLES) for name, p in PAPER.items()} | own
    return known | effect.derive_parameters(**own)


def arguments_of_motion(effect, rng):
    """Sample a motion, frame times and points in view, one sample a candidate."""
    t = np.arange(60) * 0.005
    wave = np.cumsum(np.cumsum(rng.normal(size=(1, 60, 3)), axis=1), axis=1) * 0.02
    known = {"t": t, "angles": wave, "pose": wave, "times": t[:4], "camera": CAMERA}
    known |= {
        "points": rng.uniform(-0.5, 1, (SAMPLES, 4, 5, 2)),
        "velocity": 5 * rng.normal(size=(SAMPLES, 4, 5, 2)),
    }
    dimensions = {"joints": 3, "grasp": 3, "times": 2, "observe": 4}[
        next(iter(effect.laws()))
    ]
    shape = (SAMPLES, *[1] * (dimensions - 1))
    return known | {
        p.name: draw_values(p, rng, SAMPLES).reshape(shape) for p in effect.parameters
    }


def samples(effect, seed):
    rng = np.random.default_rng(seed)
    return (
        arguments_of_string if issubclass(effect, StringEffect) else arguments_of_motion
    )(effect, rng)


def law_of(effect, name):
    """Return the law as a function of all samples, with an array as its value."""
    law = effect.laws()[name]
    return lambda known: np.asarray(law(**{a: known[a] for a in law_arguments(law)}))


def test_the_library_finds_every_file_without_registration():
    assert set(NAMES) <= set(LIBRARY)


@pytest.mark.parametrize(
    ("effect", "invariant"),
    INVARIANTS,
    ids=lambda each: getattr(each, "name", None) or each.sentence,
)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_laws_satisfy_their_declared_invariants(effect, invariant, seed):
    assert invariant.error(law_of(effect, invariant.law), samples(effect, seed)) < 1e-9


@pytest.mark.parametrize("effect", ADDED, ids=lambda e: e.name)
def test_laws_are_zero_at_their_start(effect):
    known = samples(effect, 0)
    still = {p.name: 0 * known[p.name] + p.start for p in effect.parameters}
    known |= still
    if issubclass(effect, StringEffect):
        known |= effect.derive_parameters(**still)
    absent = {"joints": "angles", "grasp": "pose", "times": "t", "observe": "points"}
    for name in effect.laws().keys() - {
        "hinge_memory",
        "grasp_memory",
    }:  # the string feels a hinge's moment, not its memory
        value = law_of(effect, name)(known)
        np.testing.assert_allclose(
            value - known.get(absent.get(name), 0.0), 0.0, atol=1e-15, err_msg=name
        )


# --- a law gives the same result in other metres and seconds

# Units of constants in laws (of nature or of smoothing). New units must not change
# their numbers.
CONSTANTS = {
    "contact": "m/s",
    "box_contact": "m/s",
    "gravity": "m/s2",
    "gravity_direction": "m/s2",
    "grasp_slip": "s",
}
OTHER_UNITS = {
    "joints": "rad",
    "times": "s",
    "observe": "m",
    "t": "s",
    "angles": "rad",
    "points": "m",
    "velocity": "m/s",
    **dict.fromkeys(["x", "y", "s", "length"], "m"),
}


def exponents(unit: str) -> np.ndarray:
    """Return the powers of metre and second in a unit like 'N s2/(m kg)'.

    Mass cancels in all units of the effects.
    """
    known = {
        "m": (1, 0, 0),
        "s": (0, 1, 0),
        "kg": (0, 0, 1),
        "N": (1, -2, 1),
        "rad": (0, 0, 0),
    }
    total = np.zeros(3)
    for sign, part in zip((1, -1), f"{unit}/1".split("/"), strict=False):
        for name, power in re.findall(r"([a-zA-Z]+)(\d?)", part):
            total += sign * int(power or 1) * np.array(known[name])
    assert total[2] == 0, unit
    return total[:2]


def scales(effect) -> list[tuple[float, float]]:
    """Return sizes of the new metre and second."""
    if effect.name not in CONSTANTS:
        return [(1 / 3.0, 1.0), (1.0, 1 / 7.0)]
    metre, second = exponents(CONSTANTS[effect.name])
    return [(1 / 3.0**second, 3.0**metre)]


@pytest.mark.parametrize(
    ("effect", "law"), LAWS, ids=lambda each: getattr(each, "name", each)
)
def test_laws_do_not_depend_on_the_system_of_units(effect, law):
    known = samples(effect, 1)
    slot = SLOTS.get(law)
    units = OTHER_UNITS | (
        dict(slot.arguments) | {"value": slot.unit}
        if slot
        else {"value": OTHER_UNITS.get(law, "")}
    )
    powers = {name: exponents(unit) for name, unit in units.items() if unit}
    powers |= {
        p.name: exponents(p.unit) + [p.length_power, 0]
        for p in (*PAPER.values(), *effect.parameters)
    }
    pose = np.stack([[1, 0], [1, 0], [0, 0]]).astype(float)
    powers |= {"pose": pose} | ({"value": pose} if law == "grasp" else {})
    for metre, second in scales(effect):
        size = {
            name: np.prod(np.array([metre, second]) ** power, axis=-1)
            for name, power in powers.items()
        }
        other = {
            name: value / size[name] if name in size else value
            for name, value in known.items()
        }
        other["camera"] = replace(CAMERA, px_per_m=CAMERA.px_per_m * metre)
        if issubclass(effect, StringEffect):
            other |= effect.derive_parameters(
                **{p.name: other[p.name] for p in effect.parameters}
            )
        expected = law_of(effect, law)(known) / size["value"]
        np.testing.assert_allclose(
            law_of(effect, law)(other),
            expected,
            rtol=1e-9,
            atol=1e-9 * np.abs(expected).max(),
        )


# --- effects in the whole model


@pytest.fixture(scope="module")
def swing_motions(arm, camera):
    """Simulate a swing by the plain model and by one with every effect.

    All effects have their start values.
    """
    plain = Model(String(0.3), arm, camera)
    motion = swing()
    moved = resample_joint_motion(
        motion.commands["t"].to_numpy(), motion.commands[list(JOINTS)].to_numpy()
    )
    return plain, plain.with_effects(*ADDED), moved, np.linspace(-0.05, 0.6, 66)


def test_an_absent_effect_equals_a_present_one_at_its_start(swing_motions):
    plain, full, motion, t = swing_motions
    expected = plain.simulate_observation(
        motion, plain.values(BASE_VALUES)[None], t
    ).points
    found = full.simulate_observation(motion, full.values(BASE_VALUES)[None], t).points
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    "parameter", [e.qualified_name(p) for e in ADDED for p in e.parameters]
)
def test_every_parameter_moves_the_string_smoothly(swing_motions, parameter):
    """Every parameter moves the string smoothly.

    Central differences in exponents agree with those of half the step. The step is a
    tenth of the range; differences are not zero.
    """
    _, full, motion, t = swing_motions
    place = full.names.index(parameter)
    known = full.parameters[place]
    acting = ACTING_VALUES.get(parameter, {})
    base = full.values(BASE_VALUES | acting)
    chi = known.chi(base[place])
    chi += 0.0 if parameter in acting else 0.1 * (1 - known.chi(known.start))
    step = 1e-4
    values = np.tile(base, (4, 1))
    values[:, place] = known.value(chi + np.array([1, -1, 0.5, -0.5]) * step)
    seen = full.simulate_observation(motion, values, t)
    assert seen.finite.all()
    coarse = (seen.points[0] - seen.points[1]) / (2 * step)
    fine = (seen.points[2] - seen.points[3]) / step
    share = np.linalg.norm(coarse - fine) / np.linalg.norm(fine)
    assert np.abs(fine).max() > 1e-3
    assert share < 0.02


def test_strings_with_all_effects_stay_finite(swing_motions):
    """Strings with every effect at once stay finite.

    Parameters are anywhere in all ranges, on a floor and a box below the hand. The
    step's bound covers every active force.
    """
    _, full, motion, t = swing_motions
    rng = np.random.default_rng(0)
    values = np.array([draw_values(p, rng, 32) for p in full.parameters]).T
    values[:, :8] = full.values(BASE_VALUES)[:8]
    values[:, full.names.index("contact.height")] = rng.uniform(-0.5, -0.1, 32)
    values[:, full.names.index("contact.tilt")] = rng.uniform(-0.3, 0.3, 32)
    values[:, full.names.index("box_contact.centre_x")] = rng.uniform(0.5, 0.9, 32)
    values[:, full.names.index("box_contact.centre_y")] = rng.uniform(-0.9, -0.5, 32)
    assert full.simulate_observation(motion, values, t).finite.all()


def test_the_step_bound_does_not_depend_on_the_origin(swing_motions):
    """The bound of the step does not depend on the origin.

    The origin may lie behind a plane that absorbs impacts, or inside a box.
    """
    _, full, _, _ = swing_motions
    behind = {"contact.height": 0.4, "box_contact.centre_x": 0.0}
    before = {"contact.height": -0.4}
    contact_values = {
        "contact.stiffness": 4e6,
        "contact.loss": 0.03,
        "box_contact.stiffness": 5e4,
        "box_contact.loss": 0.03,
    }
    material = full.string.material(
        np.stack(
            [
                full.string.values(BASE_VALUES | contact_values | place)
                for place in (behind, before)
            ]
        )
    )
    steps, possible = steps_per_tick(
        *full.string.without_absent_effects(material), 5e-3
    )
    assert possible.all()
    assert steps[0] == steps[1]


# --- descriptions and pictures


@pytest.mark.parametrize("effect", LIBRARY.values(), ids=lambda e: e.name)
def test_effects_have_descriptions_and_plots(effect):
    small, large = (
        {p.name: float(p.value(np.asarray(chi))) for p in effect.parameters}
        for chi in (0.6, 0.9)
    )
    sentence = effect.describe(small)
    assert len(sentence) > 10
    assert not sentence.endswith(".")
    assert not effect.parameters or sentence != effect.describe(large)
    assert effect.reference
    axes = Figure().add_subplot()
    effect.plot(axes, small)
    assert axes.has_data()
    assert axes.get_xlabel()


@pytest.mark.parametrize(
    ("stiffness", "said"), [(1400.0, "sinks 7 mm into it"), (1e5, "turned 0 degrees")]
)
def test_an_unusually_soft_plane_is_described_as_soft(stiffness, said):
    """A plane that is unusually soft is reported as soft.

    A mass sinks to the depth d with m g = k d.
    """
    known = {"stiffness": stiffness, "height": -0.2, "tilt": 0.0}
    assert LIBRARY["contact"].describe(known).endswith(said)


@pytest.mark.parametrize("effect", ADDED, ids=lambda e: e.name)
def test_parameter_ranges_contain_their_start(effect):
    for p in effect.parameters:
        assert p.low <= p.start <= p.high
        # only the first parameter may start at zero
        assert p.low in (0.0, -p.high) or (p.low > 0 and p != effect.parameters[0])
        assert p.meaning
        chi = np.linspace(0, 1, 11)
        np.testing.assert_allclose(p.chi(p.value(chi)), chi, atol=1e-9)
        assert (np.diff(p.value(chi)) > 0).all()
        assert p.chi(p.low - 1.0) == 0.0


# --- a new effect in one file


def test_arguments_of_laws_are_known():
    """Arguments of laws are known.

    A law may take arguments of four kinds: its slot's, the paper's parameters, its own,
    and derived ones.
    """
    for effect, law in LAWS:
        if law in SLOTS:
            own = {p.name: p.start for p in effect.parameters}
            known = {
                *SLOTS[law].arguments,
                *PAPER,
                *own,
                *effect.derive_parameters(**own),
            }
            assert set(law_arguments(effect.laws()[law])) <= known, effect.name


def test_effects_act_in_physical_order_independent_of_naming_order(swing_motions):
    """Effects act in their physical order, whatever is named first.

    Play acts after the motor's gain. If the motor turns 10 % too far, the joint lags by
    half its gap, not by 0.55 of it.
    """
    plain, _, motion, _ = swing_motions
    gain, play = LIBRARY["joint_gain"], LIBRARY["backlash"]
    ends = []
    for named in ((gain, play), (play, gain)):
        model = plain.with_effects(*named)
        known = BASE_VALUES | {"joint_gain.gain": 0.1, "backlash.gap_1": 0.1}
        ends.append(
            model.joint_motion(motion, model.values(known)[None]).angles[0, -1, 0]
        )
    turned = np.ptp(motion.angles[0, :, 0])
    np.testing.assert_allclose(
        ends, motion.angles[0, 0, 0] + 1.1 * turned - 0.05, atol=1e-12
    )


def test_an_effect_cannot_be_added_twice(arm: Arm, camera: Camera):
    model = Model(String(0.3), arm, camera).with_effects(LIBRARY["tip_mass"])
    for twice in ("tip_mass", "gravity"):
        with pytest.raises(ValueError, match=f"'{twice}' is active already"):
            model.with_effects(LIBRARY[twice])
