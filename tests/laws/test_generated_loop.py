"""The generated step loops: their text, and which of them are compiled."""

import ast
from itertools import combinations, product

import numpy as np

from stringcast.stages.model.effects.maxwell_slip import MaxwellSlip
from stringcast.stages.model.engine.compile_loops import LOOPS
from stringcast.stages.model.engine.implicit_leapfrog import ImplicitLeapfrog
from stringcast.stages.model.engine.kernel_codegen import generate_source
from stringcast.stages.model.engine.print_loop import main as print_loop
from stringcast.stages.model.engine.simulate import simulate
from stringcast.stages.model.hand import resample_hand_motion
from stringcast.stages.model.string import (
    COSTLY_EFFECTS,
    JOINTLY_COMPILED_EFFECTS,
    PAPER_EFFECTS,
    String,
)


def test_the_loop_can_be_printed(capsys):
    """The loop can be printed.

    The printed text is a Python module: the compiled loop for the paper's forces and
    the effects named.
    """
    print_loop([])
    paper = capsys.readouterr().out
    assert "run" in {
        node.name for node in ast.parse(paper).body if isinstance(node, ast.FunctionDef)
    }
    print_loop(["maxwell_slip"])
    assert "def maxwell_slip_hinge_memory(" in capsys.readouterr().out
    assert "maxwell_slip" not in paper


def test_all_effects_of_the_library_need_three_loops():
    """The paper's forces, effects that cost little, and the others have a loop each.

    The set-up compiles all three.
    """
    integrator = ImplicitLeapfrog()

    def compiled_loops(combinations_of_effects):
        sources = set()
        for effects_in_use in combinations_of_effects:
            effects = (*PAPER_EFFECTS, *effects_in_use)
            string = String(0.3, effects=effects, integrator=integrator)
            material = string.material(string.start_values()[None])
            looped, _ = string.with_compiled_effects(material)
            source = generate_source(
                looped.effects, looped.row_names, looped.integrator
            )
            sources.add(source)
        return sources

    paper = compiled_loops([()])
    cheap = compiled_loops(combinations(JOINTLY_COMPILED_EFFECTS, 2))
    costly = compiled_loops(product(JOINTLY_COMPILED_EFFECTS, COSTLY_EFFECTS))
    costly |= compiled_loops([(effect,) for effect in COSTLY_EFFECTS])
    assert len(paper) == len(cheap) == len(costly) == 1
    all_loops = paper | cheap | costly
    assert len(all_loops) == 3
    prepared = [effects for method, effects in LOOPS if method == integrator]
    assert compiled_loops(prepared) == all_loops


def test_absent_jointly_compiled_effects_change_nothing(monkeypatch):
    """An effect that is compiled but absent changes nothing.

    The joint loop agrees with a separate loop of the active effects. The loop of
    inexpensive effects agrees with the loop of all effects.
    """
    times = np.arange(0, 0.5, 0.005)
    wave = 0.3 * np.sin(2 * np.pi * times / 0.5) ** 2
    hand = resample_hand_motion(
        times, np.stack([wave, wave / 2, wave - np.pi / 2], axis=-1)
    )
    mesh = {
        "points": 13,
        "integrator": ImplicitLeapfrog(),
        "tip_cell": 0.5,
        "grasp_cell": 0.5,
    }

    def points(*effects, **absent):
        string = String(0.3, effects=(*PAPER_EFFECTS, *effects), **mesh)
        sizes = {p.name: p.value(0.55) for p in string.parameters} | absent
        return simulate(string, hand, string.values(sizes)[None], times).points

    def assert_equal(points, other):
        assert np.isfinite(points).all()
        np.testing.assert_allclose(points, other, atol=1e-7)

    cheap = points(*JOINTLY_COMPILED_EFFECTS[:4])
    no_slip = {"maxwell_slip.cap": 0.0}
    assert_equal(cheap, points(*JOINTLY_COMPILED_EFFECTS[:4], MaxwellSlip, **no_slip))

    effects_in_use = (*JOINTLY_COMPILED_EFFECTS[4:], MaxwellSlip)
    joint_points = points(*effects_in_use)
    monkeypatch.setattr(
        String, "with_compiled_effects", lambda self, material: (self, material)
    )
    assert_equal(joint_points, points(*effects_in_use))
