"""The description of a dataset in its file dataset.yaml."""

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
from stringcast.data.schema import UNSET, DataError

FORMAT_VERSION = 1  # key `format` of dataset.yaml
DATASET_FILE = "dataset.yaml"
MAX_WIDTH_PX = 2**20  # [px]: OpenCV reads no wider pictures
MAX_VALUE_CHARACTERS = 200  # characters shown of a value
MAX_FPS = 1e5  # [1/s], as of a camera in the settings
MAX_LENGTH_M = 1000.0  # [m]: longer than any string, even in millimetres


def _refuse_bool(value: Any) -> Any:
    """Refuse true and false, which would pass as 1 and 0."""
    if isinstance(value, bool):
        raise ValueError("it must be a number")
    return value


NotBool = BeforeValidator(_refuse_bool)
Number = Annotated[float, Field(allow_inf_nan=False), NotBool]
PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False), NotBool]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False), NotBool]
PixelCount = Annotated[int, Field(ge=16, le=MAX_WIDTH_PX), NotBool]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
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
    """The block `string` of dataset.yaml.

    length: grasp to tip [m]. mass: of the string [kg]. tip_mass: hung at its tip [kg].
    """

    length: Annotated[float, Field(gt=0, le=MAX_LENGTH_M), NotBool] = UNSET
    mass: PositiveNumber = UNSET
    tip_mass: NotNegative = UNSET

    @model_validator(mode="after")
    def _require_string_mass(self) -> StringBlock:
        if self.tip_mass and self.mass is UNSET:
            raise ValueError("tip_mass needs the string's own mass, in kg")
        return self


class NoiseBlock(Block):
    """The block `noise` of dataset.yaml.

    point_sigma: one standard deviation of a measured coordinate [m].
    """

    point_sigma: Annotated[float, Field(ge=MIN_SIGMA_M, le=MAX_LENGTH_M), NotBool] = (
        UNSET
    )


class ArmBlock(Block):
    """The block `arm` of dataset.yaml.

    links: lengths, base first [m]. base: position of joint 1 [m].
    """

    links: Annotated[list[PositiveNumber], Field(min_length=3, max_length=3)] = UNSET
    base: Pair = UNSET


class LensBlock(BaseModel):
    """The block `camera.lens` of dataset.yaml.

    focal: lengths fx, fy [px]. centre: principal point cx, cy [px]. distortion: k1, k2,
    p1, p2 of OpenCV.
    """

    model_config = ConfigDict(extra="forbid")
    focal: Annotated[list[PositiveNumber], Field(min_length=2, max_length=2)]
    centre: Pair
    distortion: Annotated[list[Number], Field(min_length=4, max_length=4)]


class CameraBlock(Block):
    """The block `camera` of dataset.yaml.

    fps: of filming [1/s]. width, height: [px]. px_per_m: [px/m]. origin_px: position of
    the world's origin [px]. distortion: radial coefficient, with radii in half widths;
    not with `lens`. rotation, tilt: [rad].
    """

    fps: Annotated[float, Field(gt=0, le=MAX_FPS), NotBool] = UNSET
    width: PixelCount = UNSET
    height: PixelCount = UNSET
    px_per_m: PositiveNumber = UNSET
    origin_px: Pair = UNSET
    distortion: Number = UNSET
    rotation: Number = UNSET
    tilt: Pair = UNSET
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
                "camera.tilt needs camera.lens: calibrate, or leave out the tilt"
            )
        return self


class ClockBlock(BaseModel):
    """The block `clock` of dataset.yaml.

    low, high: 95 % interval of the remaining offset to add to times of points [s].
    added: offset that `import` has added, for all trials or by trial [s].
    """

    model_config = ConfigDict(extra="forbid")
    low: Number
    high: Number
    added: Number | dict[str | int | float, Number] = UNSET

    @model_validator(mode="after")
    def _require_interval(self) -> ClockBlock:
        if not self.low < self.high:
            raise ValueError("low must be below high, in seconds")
        return self


class TrialBlock(Block):
    """The block of one trial in dataset.yaml.

    role: held_out trials measure the gain. initial: rest or moving. invalid: reason to
    exclude the trial.
    """

    role: str | None = None
    invalid: str | None = None
    initial: Literal["rest", "moving"] = UNSET


class Metadata(Block):
    """The content of dataset.yaml."""

    format: Literal[1] = 1
    string: StringBlock = UNSET
    noise: NoiseBlock = UNSET
    arm: ArmBlock = UNSET
    camera: CameraBlock = UNSET
    clock: ClockBlock = UNSET
    geometry: Literal["measured"] = UNSET
    trials: dict[str | int | float, TrialBlock | None] = UNSET
    initial: Literal["rest", "moving"] = UNSET


def read_metadata(folder: Path) -> dict[str, Any]:
    """Read and check the file dataset.yaml of a folder; empty if there is none.

    Raises DataError if a value is wrong; it names the key and the remedy.
    """
    path = folder / DATASET_FILE
    if not path.exists():
        return {}
    content = read_yaml(require_inside(folder, path))
    if not content:
        raise DataError(
            path,
            "it is empty",
            "Restore it, or write what is known: format: 1",
        )
    version = content.get("format", FORMAT_VERSION)
    if version != FORMAT_VERSION or isinstance(version, bool):
        raise DataError(
            path,
            f"format is {version!r}; this version reads {FORMAT_VERSION}",
            "Convert it.",
        )
    try:
        Metadata.model_validate(content)
    except ValidationError as error:
        key, fault = _first_fault(error)
        raise DataError(
            path,
            f"{key} {fault}",
            "Correct it; all is in metres, seconds and radians.",
            field=key,
        ) from error
    if "trials" in content:
        trials = content["trials"].items()
        content["trials"] = {str(name): block or {} for name, block in trials}
    return content


def _first_fault(error: ValidationError) -> tuple[str, str]:
    """Return the key of the first fault, and its value and requirement in words."""
    fault = error.errors()[0]
    key = ".".join(str(part) for part in fault["loc"] if part != "[key]")
    if fault["type"] == "missing":
        return key, "is missing"
    message = fault["msg"][:1].lower() + fault["msg"][1:]
    must = FAULT_WORDS.get(fault["type"], message).format(**fault.get("ctx", {}))
    value = repr(fault["input"])
    if len(value) > MAX_VALUE_CHARACTERS:
        value = f"{value[:MAX_VALUE_CHARACTERS]}..."
    return key, f"is {value}; {must}"
