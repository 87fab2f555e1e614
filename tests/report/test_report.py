"""The page of a run is self-contained and correct, and states what is missing."""

import base64
import hashlib
import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from stringcast.data.artifacts import JOINTS, Motion, Points, Trial
from stringcast.data.estimates import Estimate
from stringcast.stages.common import readable_name
from stringcast.stages.hit_test import MAX_GAP_S, HitResult
from stringcast.stages.model.box import Box
from stringcast.stages.model.interpolation import interpolate_rows
from stringcast.stages.model.model import Model
from stringcast.stages.model.string import String
from stringcast.stages.model.target import Target
from stringcast.stages.report.charts.camera import (
    MAX_PAGE_FRAMES,
    MIN_CAST_FRAMES,
    blank_frame,
    cast_film_data,
    choose_frames,
    closest_approach_picture,
    draw_frame,
    region_of_run,
)
from stringcast.stages.report.charts.cast import (
    cast_path_picture,
    distance_map,
    distances,
    hand_paths_picture,
    history_picture,
)
from stringcast.stages.report.page import Page as ReportPage
from stringcast.stages.report.pages.cast import cast_page
from stringcast.stages.report.records import CastRecord, RunRecord
from stringcast.stages.report.theme import STYLE_SHEET, THEME, svg_picture
from tests.report.page_reader import Page, decode_image, fixed_colours

STRING = String(0.3)
DURATION = 0.4
TARGET = Target(0.5, 0.75, 0.02, 0.04)


# --- a plausible run made by hand
def swing(t, lag):
    """Return a string (F, n, 2) and the joint angles (F, 3).

    The string trails the hand by an angle that grows with s.
    """
    q = np.array([0.9, 0.5, 0.3]) + np.outer(
        np.sin(np.clip(t, 0, DURATION) * 5), [0.5, 0.4, -0.6]
    )
    return q, q.sum(axis=1)[
        :, None
    ] - np.pi / 2 - lag * STRING.arc_lengths() / STRING.length


def strings(arm, t, lag):
    q, angle = swing(t, lag)
    steps = (
        STRING.segment_length
        * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, :-1]
    )
    return arm.joint_positions(q)[:, -1:] + np.concatenate(
        [np.zeros((len(t), 1, 2)), np.cumsum(steps, axis=1)], axis=1
    )


def film(camera, lines, rng, noise=6.0):
    images = (
        rng.normal(40, noise, (len(lines), camera.height, camera.width))
        .clip(0, 90)
        .astype(np.uint8)
    )
    for image, line in zip(images, lines, strict=True):
        cv2.polylines(
            image,
            [np.round(camera.pixels(line) * 16).astype(np.int32)],
            False,
            255,
            2,
            cv2.LINE_AA,
            4,
        )
    return list(images)


def estimated(rng, t, symbols=STRING.parameters):
    rows = [
        (
            p.name,
            p.symbol,
            p.unit,
            p.meaning,
            p.value(0.4),
            p.value(0.3),
            p.value(0.5),
            p.low,
            p.high,
            0.4,
            False,
            i != 2,
        )
        for i, p in enumerate(symbols)
    ]
    columns = [c.name for c in Estimate.TABLES["parameters"].columns]
    fit = {
        "method": "test",
        "before": 0.4,
        "after": 0.9,
        "rms_before": 0.0456,
        "rms_after": 0.0123,
        "residual_ratio": 2.0,
        "mesh_error": 0.0021,
        "rejected": 3,
    }
    matching = pd.DataFrame(
        {
            "trial": "t01",
            "t": t,
            "before": 0.4 + 0 * t,
            "after": 0.9 + rng.normal(0, 0.02, len(t)),
        }
    )
    sentence = "This data cannot determine k_h: other values fit as well."
    table = pd.DataFrame(rows, columns=columns)
    return Estimate(
        table, pd.DataFrame(), matching, pd.DataFrame([fit | {"sentence": sentence}])
    )


def simulated_cast(arm, camera, number=1, hit=False, noise=6.0):
    """Return a cast whose simulation after estimation agrees exactly with the film."""
    rng = np.random.default_rng(number)
    t = np.arange(-0.1, DURATION + 0.1, 0.01)
    true, before = strings(arm, t, 0.9), strings(arm, t, 0.4 / number)
    ticks = np.arange(-0.1, DURATION + 0.1, 0.005)
    joints = dict(zip(JOINTS, swing(ticks, 0)[0].T, strict=True))
    read = np.arange(len(t)) % 17 != 5
    s = np.linspace(0, STRING.length, 24)
    along = [interpolate_rows(s, STRING.arc_lengths(), line) for line in true]
    points = pd.concat(
        pd.DataFrame(
            {
                "t": t[f],
                "s": s,
                "x": along[f][:, 0],
                "y": along[f][:, 1],
                "sigma": 1e-3,
                "valid": True,
            }
        )
        for f in np.flatnonzero(read)
    )
    tips = np.where(read[:, None], true[:, -1], np.nan)
    readings = pd.DataFrame(
        {
            "frame": range(len(t)),
            "t": t,
            "valid": read,
            "tip_x": tips[:, 0],
            "tip_y": tips[:, 1],
        }
    )
    readings["reason"] = np.where(read, "", "the string is hidden behind the arm")
    plan = {"duration": DURATION, "t_hit": 0.25, "tried": 4321}
    attempts = pd.DataFrame(
        {"outcome": ["a joint leaves its range", "hit"], "count": [4320, 1]}
    )
    moving = pd.DataFrame({"t": ticks, **joints}).query("0 <= t <= @DURATION")
    empty = pd.DataFrame()
    link = {"valid": True, "reason": "", "ticks": len(ticks), "missed": 2}
    link |= {"jitter_p50": 2e-5, "jitter_p99": 9e-5, "jitter_max": 1e-3}
    images = film(camera, true, rng, noise)
    trial = Trial(
        pd.DataFrame({"t": ticks, **joints}),
        empty,
        readings[["frame", "t"]],
        pd.DataFrame([link]),
        images,
    )
    verdict = HitResult(hit, 0.252, 0.0042 if hit else 0.0237 / number)
    motion = Motion(moving, empty, empty, attempts, pd.DataFrame([plan]))
    return CastRecord(
        motion,
        trial,
        Points(points, readings, empty),
        estimated(rng, t),
        verdict,
        before,
        true,
    )


@pytest.fixture(scope="module")
def small(camera):
    """Return the default camera at a quarter of its size, with a distorting lens."""
    u, v = camera.origin_px
    sizes = {
        "width": camera.width // 4,
        "height": camera.height // 4,
        "px_per_m": camera.px_per_m / 4,
    }
    return replace(camera, **sizes, origin_px=(u / 4, v / 4), distortion=-0.06)


def record_of(arm, camera, casts, **other):
    hit = bool(casts) and casts[-1].verdict.hit
    facts = {
        "name": "stringT",
        "sentence": f"The tip {'reached' if hit else 'did not reach'} the target in {len(casts)} casts.",
        "hit": hit,
        "obstacles": (Box(0.9, 0.3, 0.05, 0.3),),
        "estimates": tuple(c.estimate for c in casts if c.estimate is not None),
        "settings": {"estimate": {"beta": 0.995}, "trials": None},
        "provenance": {
            "seed": 7,
            "code": {"commit": "0123456789abcdef", "source": "ff"},
            "packages": {"numpy": "2"},
        },
    }
    return RunRecord(
        model=Model(STRING, arm, camera),
        target=TARGET,
        casts=tuple(casts),
        **facts | other,
    )


@pytest.fixture(scope="module")
def record(arm, small):
    return record_of(
        arm,
        small,
        [simulated_cast(arm, small, 1), simulated_cast(arm, small, 2, hit=True)],
    )


@pytest.fixture(scope="module")
def page(record):
    return Page(cast_page(record))


# --- a complete page
def test_page_loads_nothing_from_elsewhere(page):
    page.require_complete()


def test_policy_allows_only_the_scripts_of_the_page(page):
    """A wrong hash would silently disable films and curves."""
    policy = next(m["content"] for m in page.all("meta") if "http-equiv" in m)
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        for script in page.scripts[-2:]
    ]
    assert policy.endswith(f"script-src 'sha256-{digests[0]}' 'sha256-{digests[1]}'")
    assert "default-src 'none'" in policy


def test_every_picture_has_a_description_and_a_size(page, record):
    images = page.all("img")
    casts = len(record.casts)
    assert len(images) == len(STRING.parameters) + 1 + casts * 3
    for image in images:
        assert len(image["alt"]) > 30
        assert "nan" not in image["alt"]
        assert int(image["width"]) > 0
        assert int(image["height"]) > 0
        if "webp" in image["src"]:
            assert (
                cv2.imdecode(
                    np.frombuffer(decode_image(image["src"]), np.uint8),
                    cv2.IMREAD_COLOR,
                )
                is not None
            )


def test_every_colour_of_a_figure_has_a_dark_version(page):
    for words, drawing in page.drawings().items():
        assert "var(--ink)" in drawing or "var(--soft)" in drawing
        assert not fixed_colours(drawing), words
    assert len({light for light, _ in THEME.values()}) == len(THEME)


def test_name_of_a_trial_is_not_parsed_as_mathematics():
    name = r"$\bad{0$"  # matplotlib would stop here with a traceback
    with style.context(STYLE_SHEET):
        figure = Figure()
        figure.text(0.5, 0.5, name)
    assert name in decode_image(svg_picture(figure, "A figure.").source).decode()


def test_text_of_a_figure_stays_text():
    """Text as outlines, with a rounded scale, would be too small to read."""
    figure = Figure()
    figure.subplots().set_xlabel("time [s]")
    drawn = decode_image(svg_picture(figure, "A figure.").source).decode()
    assert "time [s]</text>" in drawn


def test_labels_lie_inside_figures_and_legends_outside_axes(record, monkeypatch):
    """Each distinct figure is measured once."""
    figures, drawn = [], FigureCanvasSVG.print_svg
    monkeypatch.setattr(
        FigureCanvasSVG,
        "print_svg",
        lambda canvas, *a, **k: (figures.append(canvas.figure), drawn(canvas, *a, **k)),
    )
    cast, other = record.casts
    many = replace(
        record,
        casts=(cast, replace(other, verdict=replace(other.verdict, distance=1.2345)))
        * 4,
    )
    with style.context(STYLE_SHEET):
        shown_images = (
            hand_paths_picture(many),
            cast_path_picture(record, cast),
            distance_map(record, cast, 0.02),
        )
        shown_images += (history_picture(STRING.parameters[0], record.estimates),)
    unique_figures = list(dict.fromkeys(figures))  # measuring a figure draws it again
    assert len(unique_figures) == len(shown_images)
    for figure in unique_figures:
        inside, whole = figure.get_tightbbox(), figure.get_size_inches()
        assert (inside.min >= -0.01).all(), figure.axes[0].get_ylabel()
        assert (inside.max <= whole + 0.01).all(), figure.axes[0].get_ylabel()
        legends = [legend.get_window_extent() for legend in figure.legends]
        assert not any(
            legend.overlaps(axes.get_window_extent())
            for legend in legends
            for axes in figure.axes
        )


def test_same_record_gives_the_same_page(record):
    one = replace(record, casts=record.casts[:1])
    assert cast_page(one) == cast_page(one)


def test_data_cannot_become_code(arm, small, undrawn):
    evil = "</script><img src=x onerror=alert(1)>"
    cast = simulated_cast(arm, small)
    cast.points.readings.loc[5, "reason"] = evil
    text = cast_page(
        record_of(arm, small, [cast], name=evil, sentence=evil, settings={evil: evil})
    )
    assert not [a for _, a in Page(text).elements if "onerror" in a]
    assert evil in Page(text).text


# --- positions in the pictures
def shown_images(data):
    """Yield the player's frames as a browser shows them."""
    for source in data["frames"]:
        image = cv2.imdecode(
            np.frombuffer(decode_image(source), np.uint8), cv2.IMREAD_GRAYSCALE
        )
        yield cv2.resize(
            image, (data["width"], data["height"]), interpolation=cv2.INTER_LINEAR
        )


def brightness(images, lines, shift=0.0):
    """Return the mean brightness along strings of the player, shifted by `shift` [px]."""
    places = [
        (np.array(line)[None, 1:] + shift - 0.5).astype(np.float32) for line in lines
    ]
    return np.mean(
        [
            cv2.remap(i, p, None, cv2.INTER_LINEAR).mean()
            for i, p in zip(images, places, strict=True)
        ]
    )


def test_player_draws_the_simulation_on_the_filmed_string(record):
    """Strings after estimation are the filmed ones; beside them the film is darker."""
    data = cast_film_data(record, record.casts[0], region_of_run(record))
    assert (
        len(data["frames"])
        == len(data["t"])
        == len(data["strings"]["after"])
        == len(data["strings"]["measured"])
    )
    assert np.all(np.diff(data["t"]) > 0)
    assert abs(data["t"][data["start"]] - 252) <= 5
    images, after = list(shown_images(data)), data["strings"]["after"]
    shifts = np.stack(np.meshgrid(*[np.arange(-9, 10, 3)] * 2), axis=-1).reshape(-1, 2)
    bright = np.array([brightness(images, after, shift) for shift in shifts])
    beside = shifts[bright > 0.95 * bright.max()].mean(axis=0)
    camera_pixel = data["width"] / region_of_run(record).size_px[0]
    assert np.abs(beside).max() < camera_pixel / 4, (
        f"the strings lie {beside / camera_pixel} pixels beside the film"
    )
    assert brightness(images, data["strings"]["before"]) < 0.8 * brightness(
        images, after
    )


def test_pictures_draw_world_points_at_their_pixels(record, small):
    cast, part = record.casts[0], region_of_run(record)
    place = cast.after[20, -1]
    image = np.zeros((small.height, small.width), np.uint8)
    u, v = np.round(small.pixels(place)).astype(int)
    image[v, u] = 255
    blank = np.full_like(cast.after, np.nan)
    there = replace(
        cast,
        trial=replace(cast.trial, images=[image] * len(cast.frame_times)),
        before=blank,
        after=blank,
    )
    nothing = replace(record, obstacles=(), target=Target(-5, -5, 1, 1))
    figure, axes = blank_frame(part, 5.0)
    draw_frame(axes, nothing, there, 20, part)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    bright = np.asarray(canvas.buffer_rgba())[..., 0].astype(float)
    rows, columns = np.nonzero(bright > bright.max() / 2)
    seen = np.array([columns.mean(), bright.shape[0] - 1 - rows.mean()])
    drawn = axes.transData.transform([u, v])
    assert np.abs(seen - drawn).max() < 1.0, (
        "the frame and the lines over it do not share their pixels"
    )


def test_residuals_are_distances_at_equal_arc_length(record):
    cast = record.casts[0]
    exact = distances(record, cast, cast.after)
    shifted = distances(record, cast, cast.after + [0.003, -0.004])
    assert exact["distance"].max() < 1e-12
    np.testing.assert_allclose(shifted["distance"], 0.005, rtol=1e-9)
    read = np.flatnonzero(cast.points.readings["valid"])
    assert set(shifted["frame"]) == set(read.tolist())


def test_tip_path_is_not_interpolated_across_long_gaps(record):
    cast = record.casts[0]
    readings = cast.points.readings.copy()
    gap = (readings["t"] > 0.1) & (readings["t"] < 0.1 + 2 * MAX_GAP_S)
    readings.loc[gap, "valid"] = False
    holed = replace(cast, points=replace(cast.points, readings=readings))
    assert np.isnan(holed.tip_path(np.array([0.1 + MAX_GAP_S]))).all()
    np.testing.assert_allclose(
        holed.tip_path(np.array([0.2])),
        cast.after[cast.frame_at(0.2), -1][None],
        atol=1e-9,
    )


def test_parameters_of_effects_have_readable_names():
    assert readable_name("tip_mass.ratio") == "tip mass: ratio"
    assert readable_name("axial_stiffness") == "axial stiffness"


def test_page_has_the_numbers_of_the_run(page):
    for words in (
        "24 mm",
        "4 mm closest distance",
        "0.400 → 0.900",
        "45.6 mm → 12.3 mm",
        "without the error of the mesh, 2.1 mm, which charts include",
        "at 252 ms of a movement",
        "a joint leaves its range",
        "4320",
        "the string is hidden behind the arm",
        "300 mm",
        "20 × 40 mm",
        "cannot determine k h",
        "estimate.beta",
        "0.995",
        "seed 7",
        "0123456789",
        "1.00 ms",
        "(500, 750) mm",
    ):
        assert re.sub(r"\s+", " ", words) in page.text
    assert page.text.count("✓ hit") == 3
    assert page.text.count("✗ missed") == 3


# --- missing data
def nothing_read(cast):
    readings = cast.points.readings.assign(
        valid=False, tip_x=np.nan, tip_y=np.nan, reason="too dark"
    )
    points = Points(cast.points.points.iloc[:0], readings, cast.points.masks)
    return replace(
        cast, points=points, estimate=None, verdict=HitResult(False, np.nan, np.nan)
    )


def nothing_filmed(cast):
    bare = nothing_read(cast)
    trial = replace(cast.trial, images=[], frames=cast.trial.frames.iloc[:0])
    points = replace(bare.points, readings=bare.points.readings.iloc[:0])
    return replace(
        bare, trial=trial, points=points, before=cast.before[:0], after=cast.after[:0]
    )


def no_masks(cast):
    fit = cast.estimate.fit.assign(before=np.nan, after=np.nan)
    return replace(
        cast,
        estimate=replace(
            cast.estimate, matching=cast.estimate.matching.iloc[:0], fit=fit
        ),
    )


def rejected(cast):
    return replace(cast, before=np.full_like(cast.before, np.nan))


def arm_elsewhere(cast):
    readings = cast.points.readings.assign(hand_shift=0.029, joint_error=0.0942)
    return replace(cast, points=replace(cast.points, readings=readings))


def unreported(cast):
    motion = replace(cast.motion, attempts=cast.motion.attempts.iloc[:0])
    link = cast.trial.link.assign(
        valid=False,
        reason="12 commands were lost",
        jitter_p50=np.nan,
        jitter_max=np.nan,
    )
    return replace(
        cast,
        motion=motion,
        trial=replace(cast.trial, link=link, arm=cast.trial.arm.iloc[:0]),
    )


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            nothing_read,
            [
                "The tip was not read in this cast",
                "it was read in no frame",
                "too dark",
                "not estimated",
            ],
        ),
        (
            nothing_filmed,
            ["This cast has no camera frames", "there are no frames", "0 of 0"],
        ),
        (
            no_masks,
            [
                "This estimation compared no masks, so there is no matching rate",
                "not known → not known",
            ],
        ),
        (arm_elsewhere, ["the hand is up to 29 mm off", "off by 5.4 degrees"]),
        (rejected, ["before estimation diverged; it is not drawn"]),
        (
            unreported,
            [
                "not valid: 12 commands were lost",
                "The number of tried motions was not recorded",
                "reported no joint angles",
            ],
        ),
    ],
)
def test_missing_data_are_stated(arm, small, undrawn, spoil, words):
    page = Page(cast_page(record_of(arm, small, [spoil(simulated_cast(arm, small))])))
    for word in words:
        assert word in re.sub(r"\s+([.:,])", r"\1", page.text)
    assert not re.search(r"\b(nan|inf|None)\b", page.text.replace("null", ""))
    films, _ = page.explored()
    assert len(films) == len(page.all("canvas"))


def test_estimation_from_stored_trials_has_a_page(arm, small, undrawn):
    cast = simulated_cast(arm, small)
    page = Page(
        cast_page(
            record_of(
                arm,
                small,
                [],
                estimates=(cast.estimate,),
                sentence="Estimated from 1 trial.",
            )
        )
    )
    assert "Estimated from 1 trial." in page.text
    assert page.all("img") == [], "a single estimation has no history"
    twice = record_of(
        arm,
        small,
        [],
        estimates=(cast.estimate,) * 2,
        sentence="Estimated from 2 trials.",
    )
    assert len(Page(cast_page(twice)).all("img")) == len(STRING.parameters)
    assert [chart["axis"] for chart in page.explored()[1]] == ["matching rate E"]
    assert "Cast 1" not in page.text


def test_look_has_its_own_section(arm, small, undrawn):
    """It shows estimate and film, but no distance from the target."""
    cast = simulated_cast(arm, small)
    seen = replace(cast, verdict=HitResult.unknown())
    estimates = seen.estimate, cast.estimate
    with_look = record_of(arm, small, [cast], look=seen, estimates=estimates)
    page = Page(cast_page(with_look))
    text = page.text
    assert text.index("Look at the string") < text.index("The tip came within")
    duration, frames = cast.motion.duration, len(seen.points.readings)
    assert f"the arm swung slowly for {duration:.1f} s" in text
    read = int(seen.points.readings["valid"].sum())
    assert f"The string was read in {read} of {frames} frames" in text
    # the film of the look shares the frames of the page with that of the cast
    films, _ = page.explored()
    assert len(films) == 2
    assert sum(len(data["frames"]) for data in films) <= MAX_PAGE_FRAMES
    unseen = replace(seen, estimate=None)
    nothing = record_of(arm, small, [cast], look=unseen, estimates=(cast.estimate,))
    assert "Nothing was estimated from it" in Page(cast_page(nothing)).text
    assert (
        "Look at the string" not in Page(cast_page(replace(with_look, look=None))).text
    )


# --- pages of one cast to ten
def test_ten_casts_share_the_frames_of_the_page(arm, small, undrawn):
    """One and two casts are covered by the tests above."""
    page = Page(
        cast_page(
            record_of(
                arm, small, [simulated_cast(arm, small, i + 1) for i in range(10)]
            )
        )
    )
    films, _ = page.explored()
    assert len(films) == len(page.all("canvas")) == 10
    assert sum(len(data["frames"]) for data in films) <= max(
        MAX_PAGE_FRAMES, 10 * MIN_CAST_FRAMES
    )


def test_page_of_five_noisy_casts_stays_small(arm, camera):
    """The page stays below 1.5 MB.

    Scripts, text and drawings are up to 0.65 MB. The rest are frames, here with the
    strongest noise.
    """
    cast = simulated_cast(arm, camera, noise=25.0)
    record = record_of(arm, camera, [cast] * 5)
    film = json.dumps(cast_film_data(record, cast, region_of_run(record)))
    assert 5 * (len(film) + len(closest_approach_picture(record, cast).source)) < 0.85e6


@pytest.mark.long
def test_page_of_ten_casts_stays_small(arm, camera):
    text = cast_page(record_of(arm, camera, [simulated_cast(arm, camera)] * 10))
    assert 0.8e6 < len(text.encode()) < 1.5e6  # the page holds all pictures


def test_chosen_frames_include_the_closest(record):
    cast = record.casts[0]
    for most in (2, 7, 24, 500):
        chosen = choose_frames(cast, most)
        assert cast.closest_frame in chosen
        assert len(chosen) <= most
        assert chosen == sorted(set(chosen))


def test_undetermined_parameters_are_marked(page):
    """The parameter with index 2 is not determined."""
    names = [p.name.replace("_", " ") for p in STRING.parameters]
    starts = [page.text.rindex(f"{name} ") for name in names]
    words = [
        page.text[start:end].split()
        for start, end in zip(starts, [*starts[1:], None], strict=True)
    ]
    assert ["no" in row for row in words[:3]] == [False, False, True]


def test_curves_have_the_data_of_their_cast(page, record):
    """Gaps are kept, and times are those of the frames."""
    _, charts = page.explored()
    titles = ("matching rate E", "RMS [mm]", "angle [°]", "difference [°]")
    assert [chart["axis"] for chart in charts] == [*titles] * len(record.casts)
    cast, rms = record.casts[0], charts[1]
    assert rms["t"] == pytest.approx(cast.frame_times * 1e3)
    read = cast.points.readings["valid"].to_numpy()
    assert [value is not None for value in rms["lines"][0]["values"]] == read.tolist()
    away = distances(record, cast, cast.before).groupby("frame")["distance"]
    whole = [value for value in rms["lines"][0]["values"] if value is not None]
    assert whole == pytest.approx(
        away.apply(lambda some: 1e3 * np.sqrt(np.mean(some**2))).to_numpy(), rel=1e-3
    )
    assert rms["mark"] == pytest.approx(252)
    assert rms["moving"] == [0, 400]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"hardware": {"_target_": "hardware.virtual.open_lab"}}, "simulated in a virtual"),
        ({"hardware._target_": "hardware.serial.lab.open_lab"}, "an arm on a serial port"),
        ({"trials": "mine", "hardware": {"_target_": "hardware.virtual.open_lab"}}, "stored trials of mine"),
        ({}, ""),
    ],
)  # fmt: skip
def test_page_states_the_source_of_its_data(settings, said):
    """Stored trials take precedence over the virtual lab in the settings."""
    page = ReportPage(
        "cast", "a", "So.", "So.", [], {"code": {"commit": "0"}}, settings
    )
    kicker = re.search(r'class="kicker">([^<]*)<', str(page))[1]
    assert kicker.removeprefix("stringcast cast · a").lstrip(" ·").startswith(said)
    assert (page.source == "") == (said == "")
