"""dataset.yaml: what is said about a dataset beside its tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from stringcast.data.file_checks import MAX_PIXELS, read_yaml, require_inside
from stringcast.data.rows import MIN_SIGMA_M
from stringcast.data.schema import DataError

FORMAT_VERSION = 1  # of dataset.yaml, which says it under `format`
DATASET_FILE = "dataset.yaml"
MAX_WIDTH_PX = 2**20  # [px]: OpenCV reads no wider pictures
MAX_VALUE_CHARACTERS = 200  # characters of a value in a message
# [m], or mm of a metre: no string is longer, in whichever of the two it was written
MAX_LENGTH_M = 1000.0


def _refuse_bool(value: Any) -> Any:
    """A value, unless it is true or false, which count as 1 and 0 otherwise."""
    if isinstance(value, bool):
        raise ValueError("it must be a number")
    return value


NotBool = BeforeValidator(_refuse_bool)
Number = Annotated[float, Field(allow_inf_nan=False), NotBool]
PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False), NotBool]
PixelCount = Annotated[int, Field(ge=16, le=MAX_WIDTH_PX), NotBool]
# of a key that may be left out, but must hold a value where it is there
UNSET: Any = None
FAULT_WORDS = {
    "model_type": "it must hold names and values",
    "dict_type": "it must hold names and values",
    "literal_error": "it must be {expected}",
    "greater_than": "it must be above {gt}",
    "greater_than_equal": "it must be {ge} or more",
    "less_than_equal": "it must be {le} or less",
    "value_error": "{error}",
    "float_parsing": "it must be a number, without a unit",
    "float_type": "it must be a number",
    "too_short": "it must hold {min_length} values",
    "too_long": "it must hold {max_length} values",
    "extra_forbidden": "there is no such key",
}


class Block(BaseModel):
    """A block whose unknown keys are kept and ignored."""

    model_config = ConfigDict(extra="allow")


class StringBlock(Block):
    """length: grasp to tip [m]. mass: of the string [kg]. tip_mass: of what was hung at
    its tip [kg].
    """

    length: Annotated[float, Field(gt=0, le=MAX_LENGTH_M), NotBool] = UNSET
    mass: PositiveNumber = UNSET
    tip_mass: Annotated[float, Field(ge=0, allow_inf_nan=False), NotBool] = UNSET

    @model_validator(mode="after")
    def _require_string_mass(self) -> StringBlock:
        if self.tip_mass and self.mass is UNSET:
            raise ValueError(
                "tip_mass says nothing without the string's own mass, in kg"
            )
        return self


class NoiseBlock(Block):
    """The measurement noise as the dataset states it. point_sigma: one standard
    deviation of a measured coordinate [m].
    """

    point_sigma: Annotated[float, Field(ge=MIN_SIGMA_M, le=MAX_LENGTH_M), NotBool] = (
        UNSET
    )


class ArmBlock(Block):
    """links: [m], base first. base: where joint 1 sits [m]."""

    links: Annotated[list[PositiveNumber], Field(min_length=3, max_length=3)] = UNSET
    base: Annotated[list[Number], Field(min_length=2, max_length=2)] = UNSET


class LensBlock(BaseModel):
    """focal: lengths fx, fy [px]. centre: of the picture cx, cy [px]. distortion: k1,
    k2, p1, p2 of OpenCV.
    """

    model_config = ConfigDict(extra="forbid")
    focal: Annotated[list[PositiveNumber], Field(min_length=2, max_length=2)]
    centre: Annotated[list[Number], Field(min_length=2, max_length=2)]
    distortion: Annotated[list[Number], Field(min_length=4, max_length=4)]


class CameraBlock(Block):
    """fps: as filmed [1/s]. width, height: [px]. px_per_m: [px/m]. origin_px: of the
    world's origin [px]. distortion: radial, of the squared share of half the picture's
    width, without a lens. rotation, tilt: [rad].
    """

    fps: PositiveNumber = UNSET
    width: PixelCount = UNSET
    height: PixelCount = UNSET
    px_per_m: PositiveNumber = UNSET
    origin_px: Annotated[list[Number], Field(min_length=2, max_length=2)] = UNSET
    distortion: Number = UNSET
    rotation: Number = UNSET
    tilt: Annotated[list[Number], Field(min_length=2, max_length=2)] = UNSET
    lens: LensBlock | None = None

    @model_validator(mode="after")
    def _require_consistent_lens(self) -> CameraBlock:
        if (self.width or 0) * (self.height or 0) > MAX_PIXELS:
            raise ValueError(f"width x height is at most {MAX_PIXELS} pixels")
        if self.lens and self.distortion:
            raise ValueError(
                "a lens has its own distortion: leave out camera.distortion"
            )
        if not self.lens and any(self.tilt or ()):
            raise ValueError(
                "a tilt is seen by perspective, which needs camera.lens: calibrate, or leave out the tilt"
            )
        return self


class TrialBlock(Block):
    """role: held_out trials measure the gain. initial: whether the string rests when
    the trial begins. invalid: why it is not to be used.
    """

    role: str | None = None
    invalid: str | None = None
    initial: Literal["rest", "moving"] = UNSET


class Metadata(Block):
    """The whole file."""

    format: Literal[1] = 1
    string: StringBlock = UNSET
    noise: NoiseBlock = UNSET
    arm: ArmBlock = UNSET
    camera: CameraBlock = UNSET
    trials: dict[str | int | float, TrialBlock | None] = UNSET
    initial: Literal["rest", "moving"] = UNSET


def read_metadata(folder: Path) -> dict[str, Any]:
    """The content of dataset.yaml as a dict, empty where the file is missing. Raises
    DataError naming the field and the remedy.
    """
    path = folder / DATASET_FILE
    if not path.exists():
        return {}
    known = read_yaml(require_inside(folder, path))
    if known.get("format", FORMAT_VERSION) != FORMAT_VERSION or isinstance(
        known.get("format"), bool
    ):
        raise DataError(
            f"{path}: format is {known['format']!r}; this version reads {FORMAT_VERSION}. Convert it."
        )
    try:
        Metadata.model_validate(known)
    except ValidationError as error:
        # the first thing that is wrong: field, value and what it must be
        fault = error.errors()[0]
        place = ".".join(str(part) for part in fault["loc"] if part != "[key]")
        said = f"{place} is missing"
        if fault["type"] != "missing":
            must = FAULT_WORDS.get(
                fault["type"], fault["msg"][:1].lower() + fault["msg"][1:]
            )
            given = repr(fault["input"])
            given = (
                given
                if len(given) <= MAX_VALUE_CHARACTERS
                else f"{given[:MAX_VALUE_CHARACTERS]}..."
            )
            said = f"{place} is {given}; {must.format(**fault.get('ctx', {}))}"
        raise DataError(
            f"{path}: {said}. Correct it; all is in metres, seconds and radians."
        ) from error
    if "trials" in known:
        known["trials"] = {
            str(name): block or {} for name, block in known["trials"].items()
        }
    return known
