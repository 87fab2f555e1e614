"""The public interface follows the numpydoc convention."""

import pytest
from numpydoc.validate import validate

import stringcast

# no extended summary, See Also or Examples is required, nor a text for each type
OPTIONAL = {"ES01", "SA01", "EX01", "RT03", "YD01"}
PUBLIC = [
    *stringcast.__all__,
    "DiagnosisResult.plot",
    "DiagnosisResult.report",
    "EstimateResult.plot",
    "KnownString.from_run",
    "KnownString.load",
    "KnownString.mjcf",
    "KnownString.save",
]


@pytest.mark.parametrize("name", PUBLIC)
def test_public_interface_is_documented(name):
    errors = validate(f"stringcast.{name}")["errors"]
    assert [error for error in errors if error[0] not in OPTIONAL] == []
