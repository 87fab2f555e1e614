"""Straight lines at known places are read there on average, whatever their direction.

The pictures are integrated over the area of each pixel and share no code with the lab.
"""

import numpy as np
import pytest
import yaml
from conftest import ROOT

from stringcast.hardware.virtual.render import strip_coverage
from stringcast.stages.extract.centreline import UnreadableError, refine_line
from stringcast.stages.extract.extract import extract
from stringcast.stages.extract.footage import Footage
from stringcast.stages.extract.segment import SegmentedFrame
from stringcast.stages.model.camera import Camera

SETTINGS = yaml.safe_load((ROOT / "conf" / "extract" / "centreline.yaml").read_text())
SETTINGS |= {"string_length": 0.3, "arm_width": 0.0, "hidden": 0.0}
SETTINGS.pop("_target_")
SIZE_PX = 160
CAMERA = Camera(SIZE_PX, SIZE_PX, 220.0, (0.0, 0.0), 200.0)
LENGTH_PX = 0.3 * CAMERA.px_per_m
WALL_GREY = 45.0
NOISE_GREY = 2.0
SUBPIXELS = 16
FRAMES_OF_DIRECTION = 24
DIRECTIONS = np.radians([0, 90, 180, 270])  # right, down, left, up


def straight_lines(seed):
    """Return starts (F, 2) [px] and unit directions (F, 2) of lines in a film.

    They point right, down, left and up, within 20 degrees, from anywhere in a pixel.
    """
    rng = np.random.default_rng(seed)
    angle = np.repeat(DIRECTIONS, FRAMES_OF_DIRECTION)
    angle = angle + rng.uniform(-0.35, 0.35, len(angle))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    middle = SIZE_PX / 2 + rng.uniform(-30, 30, direction.shape)
    return middle - LENGTH_PX / 2 * direction, direction


def covered_area(start, direction, width):
    """Return the share of each pixel that a strip with flat ends covers.

    Only pixels near the strip are cut into subpixels.
    """
    ends = np.stack([start, start + LENGTH_PX * direction])
    first = np.floor(ends.min(axis=0) - width).astype(int)
    size = np.ceil(ends.max(axis=0) + width).astype(int) + 1 - first
    u = subpixels(first[0], size[0]) - np.float32(start[0])
    v = (subpixels(first[1], size[1]) - np.float32(start[1]))[:, None]
    along = u * direction[0] + v * direction[1]
    across = v * direction[0] - u * direction[1]
    inside = (along >= 0) & (along <= LENGTH_PX) & (np.abs(across) <= width / 2)
    parts = inside.reshape(size[1], SUBPIXELS, size[0], SUBPIXELS)
    share = np.zeros((SIZE_PX, SIZE_PX), np.float32)
    rows = slice(first[1], first[1] + size[1])
    columns = slice(first[0], first[0] + size[0])
    share[rows, columns] = parts.mean(axis=(1, 3), dtype=np.float32)
    return share


def subpixels(first, count):
    """Return the middles of the subpixels of a row of `count` pixels [px]."""
    fine = (np.arange(SUBPIXELS * count, dtype=np.float32) + 0.5) / SUBPIXELS - 0.5
    return first + fine


def pictures(starts, directions, width, contrast, seed):
    """Return noisy pictures of lines."""
    rng = np.random.default_rng(seed)
    images = []
    for start, direction in zip(starts, directions, strict=True):
        light = WALL_GREY + contrast * covered_area(start, direction, width)
        noisy = light + NOISE_GREY * rng.standard_normal(light.shape)
        images.append(np.rint(np.clip(noisy, 0, 255)).astype(np.uint8))
    return images


def read_lines(images, starts):
    """Return the lines (F, K, 2) [px] that are read in pictures."""
    t = np.arange(len(images)) / CAMERA.fps
    grasp = np.column_stack([CAMERA.world(starts), np.zeros(len(starts))])
    found = extract(Footage(t, images, grasp), CAMERA, **SETTINGS)
    assert found.readings["valid"].all()
    rows = found.points[["x", "y"]].to_numpy()
    return CAMERA.pixels(rows.reshape(len(images), -1, 2))


@pytest.mark.parametrize(
    ("width", "contrast"), [(1.4, 160.0), (1.4, 60.0), (4.0, 160.0)]
)
def test_a_straight_line_is_read_without_bias(width, contrast):
    """The mean error vanishes along the line, across it, and in x and y.

    Cutting the light at twice the noise made a faint line 0.1 px short.
    """
    starts, directions = straight_lines(seed=1)
    lines = read_lines(pictures(starts, directions, width, contrast, 2), starts)
    tip_errors = lines[:, -1] - starts - LENGTH_PX * directions
    along = np.sum(tip_errors * directions, axis=1)
    assert abs(along.mean()) < 0.04

    normals = np.stack([-directions[:, 1], directions[:, 0]], axis=-1)
    across = np.einsum("fki,fi->fk", lines - starts[:, None], normals)
    assert abs(across[:, 3:].mean()) < 0.01

    by_direction = tip_errors.reshape(len(DIRECTIONS), FRAMES_OF_DIRECTION, 2)
    standard_error = by_direction.std(axis=1) / np.sqrt(FRAMES_OF_DIRECTION)
    assert (np.abs(by_direction.mean(axis=1)) < 0.03 + 3 * standard_error).all()


def test_the_end_of_a_bent_line_is_extended_along_its_bend():
    """The tip of an arc of 25 px radius is read where it is.

    Its last width is not read but extended: straight on from its last 12 px, it is 1 px
    off.
    """
    radius = 25.0
    rng = np.random.default_rng(6)
    turn = np.linspace(0, LENGTH_PX / radius, 200)
    arc = radius * np.stack([np.sin(turn), 1 - np.cos(turn)], axis=-1)
    starts, images, tips = [], [], []
    for angle in np.radians(np.arange(0, 360, 15)):
        c, s = np.cos(angle), np.sin(angle)
        turned = arc @ np.array([[c, s], [-s, c]])
        line = turned - turned.mean(axis=0) + SIZE_PX / 2 + rng.uniform(-30, 30, 2)
        light = WALL_GREY + 160.0 * strip_coverage((SIZE_PX, SIZE_PX), line, 1.4)
        noisy = light + NOISE_GREY * rng.standard_normal(light.shape)
        images.append(np.rint(np.clip(noisy, 0, 255)).astype(np.uint8))
        starts.append(line[0])
        tips.append((line[-1], line[-1] - line[-2]))
    read = read_lines(images, np.array(starts))[:, -1]
    inward = []
    for point, (tip, step) in zip(read, tips, strict=True):
        normal = np.array([-step[1], step[0]]) / np.linalg.norm(step)
        inward.append((point - tip) @ normal)
    assert abs(np.mean(inward)) < 0.1


def test_mirrored_pictures_give_mirrored_lines():
    """Reading does not distinguish left from right, or up from down."""
    starts, directions = straight_lines(seed=3)
    images = pictures(starts, directions, 1.4, 160.0, 4)
    lines = read_lines(images, starts)
    last = SIZE_PX - 1
    in_rows = [np.ascontiguousarray(image[:, ::-1]) for image in images]
    in_columns = [np.ascontiguousarray(image[::-1]) for image in images]
    for axis, mirrored in enumerate((in_rows, in_columns)):
        mirrored_starts = starts.copy()
        mirrored_starts[:, axis] = last - mirrored_starts[:, axis]
        back = read_lines(mirrored, mirrored_starts)
        back[..., axis] = last - back[..., axis]
        assert np.abs((back - lines).mean(axis=0)).max() < 0.01
        assert np.abs(back - lines).max() < 0.2


def test_a_line_without_light_is_refused():
    """Noise makes dark pixels darker than the wall."""
    dark = SegmentedFrame(
        np.full((SIZE_PX, SIZE_PX), -3.0, np.float32),
        *(np.zeros((SIZE_PX, SIZE_PX), kind) for kind in (np.uint8, bool, bool)),
        NOISE_GREY,
    )
    path = np.column_stack([np.arange(20, 80), np.full(60, 50)])
    with pytest.raises(UnreadableError, match="no string"):
        refine_line(dark, path, 1.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("wrong", [np.nan, 1e30])
def test_the_lab_draws_the_finite_part_of_a_diverged_string(wrong):
    line = np.column_stack([np.linspace(10.0, 50.0, 21), np.full(21, 30.0)])
    line[15:] = wrong
    drawn = strip_coverage((64, 64), line, 2.0)
    seen_px = drawn.sum() / 2.0
    assert 26.0 - 1e-9 <= seen_px <= 28.0 + 1e-9  # of 28 px, or without the last piece
    assert not drawn[:, 40:].any()


@pytest.mark.parametrize("width", [1.4, 4.0])
def test_the_lab_draws_the_area_covered_by_a_string(width):
    """Light, its middle and its ends are those of a flat strip.

    OpenCV's lines of this kind end 0.1 to 0.4 px later, depending on the direction.
    """
    starts, directions = straight_lines(seed=5)
    v, u = np.indices((SIZE_PX, SIZE_PX))
    for start, direction in list(zip(starts, directions, strict=True))[::12]:
        vertices = start + np.linspace(0, LENGTH_PX, 30)[:, None] * direction
        drawn = strip_coverage((SIZE_PX, SIZE_PX), vertices, width)
        np.testing.assert_allclose(drawn.sum(), width * LENGTH_PX, rtol=2e-3)
        along = (u - start[0]) * direction[0] + (v - start[1]) * direction[1]
        across = (v - start[1]) * direction[0] - (u - start[0]) * direction[1]
        assert abs(np.average(across, weights=drawn)) < 0.01
        for end in (along > LENGTH_PX - 10, along < 10):
            length = drawn[end].sum() / width
            exact = covered_area(start, direction, width)[end].sum() / width
            assert abs(length - exact) < 0.05
        exact = covered_area(start, direction, width)
        assert np.sqrt(np.mean((drawn - exact)[exact > 0] ** 2)) < 0.03
