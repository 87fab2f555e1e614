"""Times of a recording's rows, from a clock, dates or frame numbers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pandas as pd

from stringcast.data.importers.columns import TIME_UNITS
from stringcast.data.importers.reader import RecordingReader, SourceColumn, list_columns
from stringcast.data.rows import describe_shared_times
from stringcast.data.schema import DataError

# [s] between samples: at longer steps, the unit must be wrong
MAX_STEP_S = 0.5
# a restart goes back by more usual steps than swapped rows
MIN_RETURN_STEPS = 10.0
MAX_RETURN_SHARE = 0.02  # share of rows: more backward steps mean unordered rows
DAY_S = 86400.0
TIME_OF_DAY = r"\d{1,2}:\d{2}:\d{2}([.,]\d+)?"


def read_times(reader: RecordingReader) -> np.ndarray:
    """Read times, (K,) [s], from the best time column or from frame numbers."""
    if clocks := reader.columns_of("time"):
        # prefer a mapped column, then the shortest name
        clocks.sort(key=lambda c: (c.how != "--map", len(c.meaning.name.split())))
        _refuse_restarted_clock(reader, clocks[0])
        fault = _stamp_fault(reader, clocks[0])
        if not fault:
            return _read_clock(reader, clocks[0])
        _refuse_unnamed_points(reader, clocks[0])
        if reader.hints.fps is None:
            raise DataError(
                reader.recording.file,
                fault,
                "Give the rate of its rows, as in --fps 200, or export times as "
                "64-bit numbers.",
            )
    fps = reader.hints.fps
    if not fps:
        raise DataError(
            reader.recording.file,
            f"no column holds times; there are {list_columns(reader.recording)}",
            "Name it with --map t=<column>, or give the camera's rate with --fps 200.",
        )
    if numbers := reader.columns_of("frame"):
        unit = f"frames, {fps:g} a second"
        return reader.read_numbers(numbers[0], "t", unit, 1 / fps, "--fps")
    _refuse_unknown_counter(reader)
    rows = reader.table.groupby(_series_names(reader)).cumcount()
    return rows.to_numpy() / fps


def _series_names(reader: RecordingReader) -> pd.Series:
    """Name the series of each row, (K,), by trial, point and arc length."""
    kinds = ("trial", "label", "arc")
    columns = [column for kind in kinds for column in reader.columns_of(kind)]
    series = pd.Series("", index=reader.table.index)
    for column in columns:
        series = series + " " + reader.table[column.name].astype(str)
    return series


def _stamps_by_series(
    reader: RecordingReader, column: SourceColumn
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield description and time stamps (n,) of each series."""
    stamps = reader.numbers(column.name).dropna().astype(float)
    for name, values in stamps.groupby(_series_names(reader)):
        words = f" of trial{name}" if str(name).strip() else ""
        yield words, values.to_numpy()


def _stamp_fault(reader: RecordingReader, column: SourceColumn) -> str:
    """Describe why the time stamps of a column are unusable; empty if usable."""
    for words, stamps in _stamps_by_series(reader, column):
        found = describe_shared_times(stamps)
        if not found:
            continue
        is_rounded = (stamps == stamps.astype(np.float32)).all()
        is_large = np.spacing(np.float32(np.abs(stamps).max())) > 1e-3
        guess = " (stored as float32?)" if is_rounded and is_large else ""
        return f"the time stamps{words} carry no time: {found}{guess}"
    return ""


def _refuse_unnamed_points(reader: RecordingReader, clock: SourceColumn) -> None:
    """Refuse rows that share times if another column distinguishes them.

    It is likely to name the points of the string.
    """
    keys = pd.DataFrame({"series": _series_names(reader)})
    keys["stamp"] = reader.table[clock.name]
    row_count = int(keys.value_counts().max())
    used = {column.name for column in reader.columns}
    for name in map(str, reader.table):
        values = reader.table[name]
        if name in used or values.nunique() != row_count:
            continue
        if not keys.assign(value=values).duplicated().any():
            raise DataError(
                reader.recording.file,
                f"{row_count} rows share each time in column '{clock.name}', and "
                f"'{name}' distinguishes them",
                f"If it names the point of the string: --map 'point={name}'; if "
                "not, take the column out.",
            )


def _refuse_restarted_clock(reader: RecordingReader, column: SourceColumn) -> None:
    """Refuse a clock that restarts within a trial: two recordings in one."""
    for words, stamps in _stamps_by_series(reader, column):
        row = _restart_row(stamps)
        if row is not None:
            raise DataError(
                reader.recording.file,
                f"column '{column.name}'{words} goes back from "
                f"{stamps[row - 1]:.10g} to {stamps[row]:.10g} in row {row + 1}, "
                "to times that were already recorded: two recordings seem to be "
                "in one",
                "Give each a file of its own, or a column 'trial'.",
                field=column.name,
            )


def _restart_row(stamps: np.ndarray) -> int | None:
    """Find the row where time stamps (n,) restart, or None.

    After a restart, times overlap with earlier ones; in unordered rows they do not.
    """
    steps = np.diff(stamps)
    usual_step = float(np.median(np.abs(steps))) if len(steps) else 0.0
    returns = np.flatnonzero(steps < -MIN_RETURN_STEPS * usual_step)
    if not len(returns) or len(returns) > MAX_RETURN_SHARE * len(stamps) + 1:
        return None
    row = int(returns[0]) + 1
    before, after = stamps[:row], stamps[row:]
    is_repeated = (after > before.min()) & (after < before.max())
    return row if is_repeated.any() else None


def _refuse_unknown_counter(reader: RecordingReader) -> None:
    """Refuse rows without times if a column may hold frame numbers with gaps."""
    series = _series_names(reader)
    used = {column.name for column in reader.columns}
    for name in map(str, reader.table):
        if name in used:
            continue
        numbers = reader.numbers(name)
        if not np.isfinite(numbers).all() or (numbers % 1 != 0).any():
            continue
        steps = numbers.groupby(series).diff().dropna()
        if len(steps) and (steps > 0).all() and (steps != 1).any():
            raise DataError(
                reader.recording.file,
                f"no column holds times, and '{name}' increases by whole numbers "
                "that are not all 1",
                f"If it is the number of the frame: --map 'frame={name}'; if "
                "not, take the column out.",
            )


def _read_clock(reader: RecordingReader, column: SourceColumn) -> np.ndarray:
    """Read a column of times [s]: numbers of any unit, or dates."""
    numbers = reader.numbers(column.name)
    if numbers.isna().all():
        return _read_dates(reader, column)
    step = typical_step(numbers)
    unit, how = column.meaning.unit, column.how
    if unit:
        _refuse_slow_clock(reader, column, step)
    else:
        unit = _time_unit(step)
        how = column.how if unit == "s" else "values"
    return reader.read_numbers(column, "t", unit, TIME_UNITS[unit], how)


def _read_dates(reader: RecordingReader, column: SourceColumn) -> np.ndarray:
    """Read a column of dates as seconds since 1970, or times of day since midnight."""
    raw = reader.table[column.name]
    texts = raw.astype(str).str.strip()
    is_time = texts.str.fullmatch(TIME_OF_DAY)
    if is_time.any():
        since_midnight = pd.to_timedelta(texts.where(is_time).str.replace(",", "."))
        day_times = since_midnight.dt.total_seconds().to_numpy(dtype=float, copy=True)
        known = np.isfinite(day_times)
        day_times[known] = np.unwrap(day_times[known], period=DAY_S)  # past midnight
        reader.note_use(column, "t", "times of day", "values", day_times)
        return day_times
    dates = pd.Series(pd.NaT, index=raw.index)
    if not pd.api.types.is_float_dtype(raw):  # such as a column of infinities
        with suppress(ValueError, TypeError, OverflowError):
            dates = pd.to_datetime(raw, errors="coerce", utc=True, format="ISO8601")
    if dates.isna().all():
        raise DataError(
            reader.recording.file,
            f"column '{column.name}' holds neither numbers nor dates such as "
            f"2026-01-31 12:00:00.005; it holds {str(raw.iloc[0])[:40]!r}",
            "Name another with --map t=<column>.",
            field=column.name,
        )
    elapsed = dates - pd.Timestamp(0, tz="UTC")
    seconds = elapsed.dt.total_seconds().to_numpy(dtype=float)
    reader.note_use(column, "t", "dates", "values", seconds)
    return seconds


def _refuse_slow_clock(
    reader: RecordingReader, column: SourceColumn, step: float
) -> None:
    """Refuse a unit in which samples are too far apart to show a motion.

    step: median difference between rows.
    """
    unit = column.meaning.unit
    if step * TIME_UNITS[unit] <= MAX_STEP_S:
        return
    likely = _time_unit(step)
    renamed = f"t_{likely}" if likely != unit else "t_<unit>"
    raise DataError(
        reader.recording.file,
        f"column '{column.name}' holds times in {unit} by its name, but its rows "
        f"are {step:.4g} {unit} apart, which shows no motion",
        f"If they are in {likely}, call the column {renamed}.",
        field=column.name,
    )


def typical_step(numbers: pd.Series) -> float:
    """Return the median difference of distinct numbers; 0 for a single one."""
    steps = np.diff(np.unique(numbers.dropna()))
    return float(np.median(steps)) if len(steps) else 0.0


def _time_unit(step: float) -> str:
    """Choose the largest unit in which a step between samples is short."""
    for unit in ("s", "ms", "us", "ns"):
        if step * TIME_UNITS[unit] < MAX_STEP_S:
            return unit
    return "s"
