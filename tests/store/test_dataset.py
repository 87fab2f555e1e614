"""Foreign datasets with points, frames or videos, and typical faults."""

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from stringcast.data import dataset
from stringcast.data.schema import DataError

T = np.arange(50) * 0.01
CAMERA = {
    "fps": 100,
    "width": 48,
    "height": 32,
    "px_per_m": 100.0,
    "origin_px": [24, 16],
}


def write_tables(folder, about, **tables):
    folder.mkdir(exist_ok=True)
    (folder / "dataset.yaml").write_text(yaml.safe_dump({"format": 1} | about))
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)


def grasp(trial="a", t=T):
    return pd.DataFrame({"trial": trial, "t": t, "x": 0.0, "y": 0.0, "theta": 0.0})


def points(trial="a", t=T):
    return pd.DataFrame({"trial": trial, "t": t, "s": 0.3, "x": 0.1, "y": -0.2})


def shade(number):
    return np.full((32, 48), 40 + 4 * number, np.uint8)


def test_frames_follow_their_list_in_time_order(tmp_path):
    (tmp_path / "frames" / "a").mkdir(parents=True)
    rows = []
    for number in (2, 0, 1, 3):
        file = f"frames/a/{number:06d}.png"
        rows.append({"trial": "a", "frame": number, "t": T[number * 10], "file": file})
        if number != 1:
            cv2.imwrite(str(tmp_path / file), shade(number))
    write_tables(tmp_path, {"camera": CAMERA}, grasp=grasp(), frames=pd.DataFrame(rows))
    read = dataset.read_dataset(tmp_path)
    film = read.films["a"]
    np.testing.assert_allclose(film.t, [0.0, 0.2, 0.3])  # the lost frame is skipped
    assert [int(image[0, 0]) for image in film.images] == [40, 48, 52]
    assert read.trials["a"].points.empty


def test_video_has_filming_times(tmp_path):
    write_tables(tmp_path, {"camera": CAMERA}, grasp=grasp())
    (tmp_path / "videos").mkdir()
    file = str(tmp_path / "videos" / "a.avi")
    # the film is four times slower
    video = cv2.VideoWriter(file, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (48, 32))
    for number in range(50):
        video.write(cv2.cvtColor(shade(number), cv2.COLOR_GRAY2BGR))
    video.release()
    film = dataset.read_dataset(tmp_path).films["a"]
    np.testing.assert_allclose(film.t, T)
    assert abs(int(film.images[30][5, 5]) - (40 + 120)) <= 3
    assert abs(int(film.images[7][5, 5]) - (40 + 28)) <= 3  # also backwards
    write_tables(tmp_path, {"camera": {k: v for k, v in CAMERA.items() if k != "fps"}})
    with pytest.raises(DataError, match=r"camera\.fps must be there"):
        dataset.read_dataset(tmp_path)


def test_bad_rows_are_dropped_and_unusable_trials_named(tmp_path):
    dirty = pd.concat(
        [points(), points().iloc[:5], points("b", T + 10), points("c")]
    ).sample(frac=1, random_state=1)
    dirty.iloc[0, dirty.columns.get_loc("x")] = np.nan
    write_tables(
        tmp_path, {}, grasp=pd.concat([grasp(), grasp("b"), grasp("d")]), points=dirty
    )
    read = dataset.read_dataset(tmp_path)
    assert set(read.trials) == {"a"}
    seen = read.trials["a"].points
    assert seen["t"].is_monotonic_increasing
    assert 48 <= len(seen) <= 50
    assert np.isfinite(seen["x"]).all()
    assert "overlap" in read.rejection_reasons["b"]
    assert "no motion" in read.rejection_reasons["c"]
    assert "no measured point" in read.rejection_reasons["d"]


def test_trials_begin_at_rest_by_default(tmp_path):
    both = {
        "grasp": pd.concat([grasp(), grasp("b")]),
        "points": pd.concat([points(), points("b")]),
    }

    def moving(about):
        write_tables(tmp_path, about, **both)
        return [
            trial.starts_moving
            for trial in dataset.read_dataset(tmp_path).trials.values()
        ]

    assert moving({}) == [False, False]
    assert moving({"initial": "moving"}) == [True, True]
    assert moving({"trials": {"b": {"initial": "moving", "role": "held_out"}}}) == [
        False,
        True,
    ]
    assert moving(
        {"initial": "moving", "trials": {"a": {"initial": "rest"}, "b": None}}
    ) == [False, True]
    for wrong in ({"initial": True}, {"trials": {"b": {"initial": "flying"}}}):
        with pytest.raises(
            DataError,
            match=r"dataset\.yaml: .*initial is .* it must be 'rest' or 'moving'",
        ):
            moving(wrong)
    with pytest.raises(
        DataError,
        match=r"dataset\.yaml: trials\.b is 'moving'; it must hold names and values",
    ):
        moving({"trials": {"b": "moving"}})
