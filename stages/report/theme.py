"""Colours and style of every page, and pictures in them: figures as data URIs that
follow light and dark.
"""

from __future__ import annotations

import base64
import io
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from PIL import Image

STYLE_SHEET = Path(__file__).parent / "theme.mplstyle"
MM_PER_M = 1e3  # [mm] in a metre
QUALITY = 50  # of WebP
# of WebP's six methods: a third of the time of its own choice, for frames a tenth
# larger
QUICK = 1
# Light and dark side of each colour. Data colours are those of Okabe and Ito, told
# apart by everyone.
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
LIGHT_COLOURS = {name: light for name, (light, _) in THEME.items()}
# camera frames are dark in either theme
ON_FRAMES = {name: dark for name, (_, dark) in THEME.items()}


@dataclass(frozen=True)
class Picture:
    """source: a data URI. alt: what it shows, in words. width, height: its natural size
    [px].
    """

    source: str
    alt: str
    width: int
    height: int


def framed(
    width: float,
    height: float,
    left: float = 0.66,
    top: float = 0.28,
    bottom: float = 0.42,
    between: float = 0.14,
) -> Figure:
    """An empty figure, all in inches, with margins for a label and numbers of five
    characters, and for a row of legend: to measure the texts first, as the layout of
    the style does, takes longer than to draw them. between: rows, in heights of one.
    """
    figure = Figure(figsize=(width, height), layout="none")  # type: ignore[arg-type]
    figure.subplots_adjust(
        left / width, bottom / height, 1 - 0.2 / width, 1 - top / height, 0.08, between
    )
    return figure


def vector(figure: Figure, alt: str) -> Picture:
    """An SVG that follows the reader's light or dark theme."""
    data = io.StringIO()
    figure.set_facecolor("none")
    # savefig draws twice
    FigureCanvasSVG(figure).print_svg(data, metadata={"Date": None})
    plain = data.getvalue()
    return _picture(
        figure, "svg+xml", themed(plain[plain.index("<svg") :]).encode(), alt
    )


def raster(figure: Figure, alt: str) -> Picture:
    """A WebP at one and a half times its natural size, for sharp screens."""
    data = io.BytesIO()
    figure.savefig(
        data, format="webp", dpi=144, pil_kwargs={"quality": QUALITY, "method": QUICK}
    )
    return _picture(figure, "webp", data.getvalue(), alt)


def webp(image: np.ndarray, quality: int) -> bytes:
    """The bytes of an image (height, width) or (height, width, 3) uint8 as WebP.
    quality: 0 to 100.
    """
    data = io.BytesIO()
    Image.fromarray(image).save(data, "webp", quality=quality, method=QUICK)
    return data.getvalue()


def themed(svg: str) -> str:
    """Name the theme's colours in an SVG and define both sides of each, and make it
    half as long.
    """
    # a hundredth of a point is enough for places, of which labels are none
    svg = re.sub(
        r'(?<= )(?:d|x|y|transform)="[^"]*"',
        lambda places: re.sub(r"(\.\d\d)\d+", r"\1", places[0]),
        svg,
    )
    for name, (light, _) in THEME.items():
        svg = svg.replace(light, f"var(--{name})")

    # without what nobody sees: names of groups, fonts, turns by nothing, blanks
    unseen = r'<metadata>.*?</metadata>|(?<=<g) id="[^"]*"|font-family: [^;]*; | transform="rotate\(-?0 [^"]*"'
    svg = re.sub(r"\s*\n\s*", " ", re.sub(unseen, "", svg, flags=re.S)).replace(
        "> <", "><"
    )
    svg = re.sub(
        r'(?<= )d="[^"]*"', lambda way: re.sub(r" ?([MLQCz]) ?", r"\1", way[0]), svg
    )
    svg = re.sub(
        r'(?<= )style="[^"]*"', lambda style: re.sub(r"([:;]) ", r"\1", style[0]), svg
    )

    # a class for each style that is there more than once
    often = [
        style
        for style, times in Counter(re.findall(r' style="([^"]*)"', svg)).items()
        if times > 1
    ]
    named = {style: f"s{number}" for number, style in enumerate(often)}
    for style, name in named.items():
        svg = svg.replace(f'style="{style}"', f'class="{name}"')
    light, dark = (
        "".join(f"--{name}:{sides[i]};" for name, sides in THEME.items())
        for i in (0, 1)
    )
    rules = f":root{{{light}}}@media (prefers-color-scheme:dark){{:root{{{dark}}}}}"
    rules += "text{font-family:system-ui,sans-serif!important}"
    rules += "".join(f".{name}{{{style}}}" for style, name in named.items())
    return re.sub(r"(<svg[^>]*>)", rf"\1<style>{rules}</style>", svg, count=1)


def data_uri(kind: str, data: bytes) -> str:
    """The data URI of an image file, as a page holds it. kind: webp, png, svg+xml."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def powers() -> FuncFormatter:
    """Labels of a logarithmic axis: 10⁻³."""
    return FuncFormatter(
        lambda value, _: "10" + superscript(f"{value:.0e}".split("e")[1])
    )


def superscript(number: str) -> str:
    """An exponent as raised figures, without leading zeros."""
    return str(int(number)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _picture(figure: Figure, kind: str, data: bytes, alt: str) -> Picture:
    width, height = figure.get_size_inches() * 96
    return Picture(data_uri(kind, data), alt, round(width), round(height))
