"""A picture of the page: a figure as a data URI, with the words for those who cannot see it."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

STYLE = Path(__file__).parent / "report.mplstyle"
MM = 1e3
# Light and dark side of each colour. Data colours are those of Okabe and Ito, told apart by everyone.
THEME = {
    "ink": ("#1f2733", "#e7ebf2"),
    "soft": ("#5d6878", "#9fabbd"),
    "axis": ("#a9b2c0", "#566274"),
    "grid": ("#e3e7ee", "#2c3542"),
    "before": ("#d55e00", "#f5924e"),
    "after": ("#0072b2", "#56b4e9"),
    "measured": ("#009e73", "#3fd3a8"),
    "target": ("#b8568f", "#e79cc6"),
    "wall": ("#8a8f98", "#6f7885"),
}
LIGHT = {name: light for name, (light, _) in THEME.items()}
ON_FRAMES = {name: dark for name, (_, dark) in THEME.items()}  # camera frames are dark in either theme


@dataclass(frozen=True)
class Picture:
    """source: a data URI. alt: what it shows, in words. width, height: its natural size [px]."""

    source: str
    alt: str
    width: int
    height: int


def vector(figure: Figure, alt: str) -> Picture:
    """An SVG that follows the reader's light or dark theme."""
    data = io.StringIO()
    figure.savefig(data, format="svg", metadata={"Date": None})
    plain = data.getvalue()
    return _picture(figure, "svg+xml", themed(plain[plain.index("<svg") :]).encode(), alt)


def raster(figure: Figure, alt: str) -> Picture:
    """A WebP at twice its natural size, for sharp screens."""
    data = io.BytesIO()
    figure.savefig(data, format="webp", dpi=192, pil_kwargs={"quality": 78})
    return _picture(figure, "webp", data.getvalue(), alt)


def themed(svg: str) -> str:
    """Name the theme's colours in an SVG and define both sides of each."""
    for name, (light, _) in THEME.items():
        svg = svg.replace(light, f"var(--{name})")
    light, dark = ("".join(f"--{name}:{sides[i]};" for name, sides in THEME.items()) for i in (0, 1))
    rules = f":root{{{light}}}@media (prefers-color-scheme:dark){{:root{{{dark}}}}}"
    rules += "text{font-family:system-ui,sans-serif!important}"
    return re.sub(r"(<svg[^>]*>)", rf"\1<style>{rules}</style>", svg, count=1)


def data_uri(kind: str, data: bytes) -> str:
    """An image as text."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def powers() -> FuncFormatter:
    """Labels of a logarithmic axis: 10⁻³."""
    return FuncFormatter(lambda value, _: "10" + superscript(f"{value:.0e}".split("e")[1]))


def superscript(number: str) -> str:
    """An exponent as raised figures, without leading zeros."""
    return str(int(number)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _picture(figure: Figure, kind: str, data: bytes, alt: str) -> Picture:
    width, height = figure.get_size_inches() * 96
    return Picture(data_uri(kind, data), alt, round(width), round(height))
