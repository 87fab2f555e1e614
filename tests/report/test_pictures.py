"""The pictures of a page as files: each there, whole, and named after the headings above it."""

import base64
import json

import pytest

from stringcast.pipeline.commands.pictures import main, pictures
from stringcast.pipeline.settings import UserError


def image(kind, content):
    return f'<img alt="x" src="data:image/{kind};base64,{base64.b64encode(content).decode()}">'


CURVES = json.dumps({"t": [0.0, 5.0], "axis": "RMS [mm]", "lines": [{"label": "a, b", "values": [1.5, None]}]})
PAGE = f"""<h2>Cast 1 <span>hit</span></h2><figure><h3>At the closest approach</h3>{image("webp", b"one")}</figure>
<figure><h3>Joint angles</h3>{image("svg+xml", b"<svg/>")}{image("svg+xml", b"<svg>2</svg>")}</figure>
<figure><h3>Distance</h3><script type="application/json">{CURVES}</script></figure><script>const nothing = 1;</script>
<h2>Cast 2</h2>{image("png", b"four")}<img src="elsewhere.png">"""


def test_each_picture_has_its_name_and_content():
    assert dict(pictures(PAGE)) == {
        "01-cast-1-hit-at-the-closest-approach.webp": b"one",
        "02-cast-1-hit-joint-angles.svg": b"<svg/>",
        "03-cast-1-hit-joint-angles.svg": b"<svg>2</svg>",
        "04-cast-1-hit-distance.csv": b't [ms],"a, b, RMS [mm]"\r\n0.0,1.5\r\n5.0,\r\n',
        "05-cast-2.png": b"four",
    }


def test_they_are_written(tmp_path):
    (tmp_path / "report.html").write_text(PAGE)
    assert main([str(tmp_path / "report.html"), str(tmp_path / "out")]) == 0
    assert len(list((tmp_path / "out").iterdir())) == 5
    with pytest.raises(UserError, match=r"nothing.html: there is no such page"):
        main([str(tmp_path / "nothing.html"), str(tmp_path / "out")])
