"""All pages open in Chromium without errors, and interactive elements respond."""

import json
import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from conftest import measured_sample

from stringcast.data.alignment import Alignment
from stringcast.data.estimates import Prediction
from stringcast.stages.check.overview import dataset_overview
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.report.pages.alignment import alignment_page
from stringcast.stages.report.pages.cast import cast_page
from stringcast.stages.report.pages.check import check_page
from stringcast.stages.report.pages.diagnosis import diagnosis_page
from stringcast.stages.report.pages.index import index_page
from stringcast.stages.report.pages.paper import paper_page
from stringcast.stages.report.pages.sweep import sweep_page
from stringcast.stages.report.pages.tables import tables_page
from stringcast.stages.report.records import PaperRecord, StageRecord
from tests.report.browser import browser, pages_are_skipped
from tests.report.test_diagnosis_page import displaced, make_diagnosis
from tests.report.test_report import record_of, simulated_cast
from tests.report.test_sweep_page import record as sweep_record
from tests.report.test_sweep_page import swept

pytestmark = pytest.mark.skipif(
    pages_are_skipped(),
    reason="NO CHROMIUM HERE: NO PAGE WAS OPENED. Install chromium.",
)
ORIGIN = {"seed": 7, "code": {"commit": "0123456789abcdef"}}
MEASURED = measured_sample()
PHONE = 360  # [px]
READY = "document.documentElement.dataset.ready === 'yes' || !document.querySelector('.explore')"


def alignment():
    row = {
        "sentence": "So.",
        "rms_before": 1e-3,
        "rms_after": 1e-4,
        "residual_ratio": 1.0,
        "noise": 1e-4,
        "speed": 2.0,
    }
    seen = pd.DataFrame(
        {
            "trial": "t",
            "t": [0.0, 0.1],
            "link": 1,
            "share": [0.5, 1.0],
            "x": 0.1,
            "y": [0.2, 0.3],
        }
    )
    seen = seen.assign(
        along_x=1.0, along_y=0.0, sigma=1e-4, before=[1e-3, 2e-3], after=1e-4
    )
    likelihood = pd.DataFrame(
        {
            "offset": [-1e-3, 0.0, 1e-3],
            "alone": [5.0, 0.0, 5.0],
            "with_lag": 1.0,
            "lag": 0.0,
        }
    )
    measured = pd.DataFrame(
        [("camera.x", "m", "shift", 1e-3, 0.0, 2e-3, True)],
        columns=list(_names(Alignment)),
    )
    return Alignment(
        measured=measured, seen=seen, likelihood=likelihood, aligned=pd.DataFrame([row])
    )


def _names(kind):
    return (column.name for column in kind.TABLES["measured"].columns)


def texts(arm, camera):
    """Return a small page of every kind."""
    camera = replace(
        camera, width=320, height=320, px_per_m=170.0, origin_px=(125.5, 193.5)
    )
    coarse = Model(String(0.3), arm, camera)
    told = make_diagnosis("effect", ["tip_mass"], missing=displaced())
    prediction = Prediction(
        **{name: table.empty() for name, table in Prediction.TABLES.items()}
    )
    tables = {
        "runs": pd.DataFrame({"seed": [], "state": []}),
        "rates": pd.DataFrame({"condition": []}),
    }
    tables |= {
        "numbers": pd.DataFrame(
            [("a", "k_h", 1.0, "1", "p")],
            columns=["what", "of", "value", "unit", "place"],
        )
    }
    casts = [simulated_cast(arm, camera, 1), simulated_cast(arm, camera, 2, hit=True)]
    runs = pd.DataFrame(
        {
            "run": ["a/b", "a/c", "a/d"],
            "experiment": "x",
            "date": ["2026-11-25T03:38:00", "2026-11-24T03:38:00", ""],
            "state": ["ended", "ended", "failed"],
            "outcome": ["hit", "effect", ""],
            "causes": ["", "wind", ""],
            "iterations": [2, 12, 0],
            "best_E": [0.9, np.nan, np.nan],
            "seconds": 3.0,
            "stale": ["s", "", ""],
            "message": "So.",
            "page": ["a/b/report.html", "a/c/report.html", ""],
        }
    )
    approaches = {"a/b": {"miss_mm": [40.0, None, 3.0], "E": [0.7, None, 0.9]}}
    return {
        "cast": cast_page(
            record_of(
                arm,
                camera,
                casts,
                next_commands=[("Again", "pipeline verify {here} <&>")],
            )
        ),
        "diagnosis": diagnosis_page(
            StageRecord("bench-7", told.sentence, told, coarse, {}, ORIGIN)
        ),
        "sweep": sweep_page(sweep_record(swept())),
        "alignment": alignment_page(
            StageRecord("a", "So.", alignment(), coarse, {}, ORIGIN)
        ),
        "tables": tables_page(StageRecord("t", "So.", prediction, coarse, {}, ORIGIN)),
        "index": index_page(runs, "outputs", ORIGIN, approaches),
        "paper": paper_page(PaperRecord(tables, 3, {}, ORIGIN), {}),
        "check": check_page(
            MEASURED,
            dataset_overview(MEASURED),
            ORIGIN,
            [("Diagnose", "pipeline +experiment=diagnose")],
        ),
    }


@pytest.fixture(scope="module")
def pages(arm, camera, tmp_path_factory):
    """Return paths of the pages by name; drawings are empty and tested elsewhere."""
    folder = tmp_path_factory.mktemp("the arm's pages")
    empty = SimpleNamespace(print_svg=lambda data, metadata: data.write("<svg></svg>"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "stringcast.stages.report.theme.FigureCanvasSVG", lambda figure: empty
        )
        made = texts(arm, camera)
    for name, text in made.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.html" for name in made}


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("chromium")) as opened:
        yield opened


def opened(chromium, path, **how):
    chromium.open(path, **how)
    chromium.wait(READY)
    return chromium


def place(chromium, selector):
    """Return left, top, width and height of an element, scrolled into view [px]."""
    ask = f"(e => (e.scrollIntoView({{block: 'center'}}), e.getBoundingClientRect()))(document.querySelector('{selector}'))"
    return chromium.ask(f"(b => [b.x, b.y, b.width, b.height])({ask})")


@pytest.mark.parametrize(
    "name",
    ["cast", "diagnosis", "sweep", "alignment", "tables", "index", "paper", "check"],
)
def test_page_opens_on_a_phone_in_dark_mode_without_errors(chromium, pages, name):
    page = opened(chromium, pages[name], width=PHONE, height=740, dark=True)
    assert page.ask("document.documentElement.scrollWidth") == PHONE, (
        "it can be pushed sideways"
    )
    assert (
        page.ask("getComputedStyle(document.body).backgroundColor") == "rgb(18, 22, 28)"
    )
    assert pages[name].stat().st_size < 1.5e6
    assert page.faults == []


def test_outcomes_of_runs_are_visible_on_a_phone(chromium, pages):
    page = opened(chromium, pages["index"], width=PHONE, height=740)
    cells = (
        "[...document.querySelectorAll('.runs tbody tr:first-child td')].slice(0, 2)"
    )
    assert page.ask(f"{cells}.map(cell => cell.textContent)") == ["hit", "a/b"]
    assert page.ask(
        f"{cells}.every(cell => cell.getBoundingClientRect().right < innerWidth)"
    )


def test_runs_are_sorted_filtered_and_charted(chromium, pages):
    page = opened(chromium, pages["index"])
    names = "shown().map(row => row.cells[1].textContent.trim())"
    assert page.ask(names) == ["a/b", "a/c", "a/d"]
    press = "[...document.querySelectorAll('.sort')].find(b => b.textContent == '{}').click()"
    page.ask(press.format("casts or trials"))
    assert page.ask(names) == ["a/d", "a/b", "a/c"], "numbers, not letters"
    page.ask(press.format("casts or trials"))
    assert page.ask(names) == ["a/c", "a/b", "a/d"]
    for words, left in (
        ("wind", ["a/c"]),
        ("E>0.8", ["a/b"]),
        ("casts>1 So", ["a/c", "a/b"]),
        ("nothing", []),
    ):
        page.ask(f"(wanted.value = '{words}', wanted.oninput())")
        assert page.ask(names) == left, words
    assert page.ask("document.querySelector('.overlay').hidden")
    page.ask("(wanted.value = '', wanted.oninput())")
    assert page.ask("document.querySelectorAll('.overlay circle').length") == 4
    assert page.faults == []


def test_pointing_at_a_curve_moves_the_clock_of_its_cast(chromium, pages):
    """Film, curves and clock of the cast follow, and those of the other cast do not."""
    page = opened(chromium, pages["cast"])
    before = page.ask("groups.map(g => g.members[0].index)")
    left, top, width, height = place(page, ".u-over")
    page.mouse("mouseMoved", left + 0.25 * width, top + height / 2)
    page.wait("groups[0].t !== null")
    times = page.ask(
        "groups[0].members.map(m => m.plot ? m.plot.data[0][m.plot.cursor.idx] : m.data.t[m.index])"
    )
    assert np.ptp(times) < 20, times
    low, high = page.ask("groups[0].members[1].range()")
    assert times[0] == pytest.approx(low + 0.25 * (high - low), abs=20)
    assert page.ask("groups.map(g => g.members[0].index)")[1] == before[1]
    assert (
        page.ask("document.querySelector('.controls output').textContent")
        == f"{page.ask('groups[0].t'):.0f} ms"
    )
    assert page.faults == []


def test_dragging_zooms_all_curves(chromium, pages):
    page = opened(chromium, pages["diagnosis"])
    whole = page.ask("groups[0].members.filter(m => m.plot).map(m => m.range())")
    left, top, width, height = place(page, ".u-over")
    page.mouse("mousePressed", left + 0.2 * width, top + height / 2, pressed=True)
    page.mouse("mouseMoved", left + 0.6 * width, top + height / 2, pressed=True)
    page.mouse("mouseReleased", left + 0.6 * width, top + height / 2)
    page.wait(f"groups[0].members.find(m => m.plot).range()[0] > {0.1 * whole[0][1]}")
    zoomed = np.array(
        page.ask("groups[0].members.filter(m => m.plot).map(m => m.range())")
    )
    assert np.ptp(zoomed, axis=0) == pytest.approx(0, abs=1e-6)
    assert np.ptp(zoomed[0]) == pytest.approx(0.4 * np.ptp(whole[0]), rel=0.05)
    page.ask("document.querySelector('.plot').focus()")
    for kind in ("keyDown", "keyUp"):
        page.call(
            "Input.dispatchKeyEvent",
            type=kind,
            key="0",
            text="0" if kind == "keyDown" else "",
        )
    page.wait("groups[0].members.find(m => m.plot).range()[0] <= 0")
    assert page.faults == []


def test_page_of_a_diagnosis_starts_with_a_playing_film(chromium, pages):
    """The film on the first screen plays in a loop until it is paused."""
    page = opened(chromium, pages["diagnosis"])
    top = page.ask("document.querySelector('canvas').getBoundingClientRect().top")
    assert top < 600
    page.ask("groups[0].controls.find('select').value = '1'")
    page.wait("groups[0].t > 0.5 * groups[0].whole[1]")
    page.wait("groups[0].t < 0.5 * groups[0].whole[1]")
    page.ask("document.querySelector('.play').click()")
    still = page.ask("groups[0].t")
    assert page.ask("document.querySelector('.play').textContent") == "Play"
    assert (
        page.ask("new Promise(done => setTimeout(() => done(groups[0].t), 100))")
        == still
    )
    links = "[...document.querySelectorAll('nav a')].map(a => a.hash.slice(1))"
    assert len(page.ask(links)) > 4
    assert page.ask(f"{links}.every(id => document.getElementById(id))")
    assert page.faults == []


def test_film_plays_and_differences_can_be_magnified(chromium, pages):
    page = opened(chromium, pages["diagnosis"])
    page.ask("window.box = document.querySelectorAll('.explore')[1]")
    drawn = "box.querySelector('canvas').toDataURL()"
    still = page.ask(drawn)
    page.ask("(s => (s.value = '20', s.onchange()))(box.querySelector('.times'))")
    assert page.ask(drawn) != still
    page.ask(
        "box.querySelector('.controls select').value = '1'; box.querySelector('.play').click()"
    )
    begun = page.ask("groups[1].t")
    page.wait(f"groups[1].t > {begun or 0}")
    page.wait("box.querySelector('.play').textContent === 'Play'")
    assert page.ask(
        "groups[1].members.filter(m => m.images).every(m => m.index === m.data.t.length - 1)"
    )
    assert page.faults == []


def test_next_commands_contain_the_folder_of_the_page(chromium, pages):
    page = opened(chromium, pages["cast"])
    command = page.ask("document.querySelector('.commands dd').textContent")
    folder = shlex.quote(str(pages["cast"].parent))
    assert command == f"pipeline verify {folder} <&>"


@pytest.mark.parametrize("width", [PHONE, 1060])
@pytest.mark.parametrize("name", ["cast", "diagnosis"])
def test_legends_lie_within_their_charts(chromium, pages, name, width):
    """Legends have one to five rows."""
    page = opened(chromium, pages[name], width=width)
    bottoms = "[...document.querySelectorAll('.plot')].map(e => [e, e.querySelector('.u-legend')].map(b => b.getBoundingClientRect().bottom))"
    page.wait(f"{bottoms}.every(([plot, legend]) => legend <= plot + 1)")
    heights = "[...document.querySelectorAll('.plot .u-wrap')].map(e => e.clientHeight)"
    assert min(page.ask(heights)) >= 120


def test_curves_follow_the_theme_and_are_printed(chromium, pages):
    page = opened(chromium, pages["cast"])
    light = page.ask("groups[0].members[1].plot.series[1].stroke()")
    page.call(
        "Emulation.setEmulatedMedia",
        features=[{"name": "prefers-color-scheme", "value": "dark"}],
    )
    page.wait(f"groups[0].members[1].plot.series[1].stroke() !== {json.dumps(light)}")
    page.call("Emulation.setEmulatedMedia", media="print")
    assert (
        page.ask("getComputedStyle(document.querySelector('.controls')).display")
        == "none"
    )
    narrow = "[...document.querySelectorAll('canvas, img')].every(e => e.getBoundingClientRect().right <= innerWidth)"
    assert page.ask(narrow)
    wide = "[...document.querySelectorAll('.plot')].map(e => e.querySelector('canvas').clientWidth / e.clientWidth)"
    assert page.ask(wide) == pytest.approx([1] * 8, abs=0.02)
    page.call("Emulation.setEmulatedMedia", media="")
    assert page.faults == []
