"""Colours and style of pages, and figures as data URIs for light and dark themes."""

from __future__ import annotations

import base64
import io
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import get_named_colors_mapping
from matplotlib.figure import Figure
from matplotlib.style import context as style_context
from PIL import Image

STYLE_SHEET = Path(__file__).parent / "theme.mplstyle"
MS_PER_S = 1e3  # [ms] in a second
WEBP_QUALITY = 50
WEBP_METHOD = 1  # a third of the time of the default, for frames a tenth larger
# Light and dark version of each colour. Data colours are those of Okabe and Ito, which
# people with any colour vision can distinguish.
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
get_named_colors_mapping().update(LIGHT_COLOURS)  # figures use the names of the theme
FRAME_COLOURS = {name: dark for name, (_, dark) in THEME.items()}  # frames are dark


def _css_variables(side: int) -> str:
    return "".join(f"--{name}:{sides[side]};" for name, sides in THEME.items())


CSS_VARIABLES = (
    f":root{{{_css_variables(0)}}}"
    f"@media (prefers-color-scheme:dark){{:root{{{_css_variables(1)}}}}}"
)


@dataclass(frozen=True)
class Picture:
    """An image of a page, as a data URI, with a description for screen readers.

    width, height: its natural size [px].
    """

    source: str
    alt: str
    width: int
    height: int


def svg_picture(figure: Figure, alt: str) -> Picture:
    """Draw a figure as an SVG that follows the reader's light or dark theme."""
    buffer = io.StringIO()
    figure.set_facecolor("none")
    # the style sheet keeps text as text; savefig would draw twice
    with style_context(STYLE_SHEET):
        FigureCanvasSVG(figure).print_svg(  # type: ignore[no-untyped-call]
            buffer, metadata={"Date": None}
        )
    text = buffer.getvalue()
    svg = apply_theme(text[text.index("<svg") :])
    return _as_picture(figure, "svg+xml", svg.encode(), alt)


def webp_picture(figure: Figure, alt: str) -> Picture:
    """Draw a figure as a WebP of 1.5 times its natural size, for sharp screens."""
    buffer = io.BytesIO()
    options = {"quality": WEBP_QUALITY, "method": WEBP_METHOD}
    figure.savefig(buffer, format="webp", dpi=144, pil_kwargs=options)
    return _as_picture(figure, "webp", buffer.getvalue(), alt)


def _as_picture(figure: Figure, kind: str, content: bytes, alt: str) -> Picture:
    width, height = figure.get_size_inches() * 96
    return Picture(data_uri(kind, content), alt, round(width), round(height))


def encode_webp(image: np.ndarray, quality: int) -> bytes:
    """Encode an image, grey or RGB, as WebP of a quality from 0 to 100."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "webp", quality=quality, method=WEBP_METHOD)
    return buffer.getvalue()


def data_uri(kind: str, content: bytes) -> str:
    """Return the data URI of an image file of a kind: webp, png or svg+xml."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def apply_theme(svg: str) -> str:
    """Replace the colours of an SVG by theme variables, and shorten it."""
    for name, light in LIGHT_COLOURS.items():
        svg = svg.replace(light, f"var(--{name})")
    svg = _shorten(svg)

    # a class for each style that occurs more than once
    counts = Counter(re.findall(r' style="([^"]*)"', svg))
    repeated = [style for style, count in counts.items() if count > 1]
    rules = CSS_VARIABLES + "text{font-family:system-ui,sans-serif!important}"
    for number, style in enumerate(repeated):
        svg = svg.replace(f'style="{style}"', f'class="s{number}"')
        rules += f".s{number}{{{style}}}"
    return re.sub(r"(<svg[^>]*>)", rf"\1<style>{rules}</style>", svg, count=1)


def _shorten(svg: str) -> str:
    """Round positions to a hundredth of a point, and drop invisible content."""
    positions = r'(?<= )(?:d|x|y|transform)="[^"]*"'
    svg = re.sub(positions, lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), svg)
    invisible = (
        r'<metadata>.*?</metadata>|(?<=<g) id="[^"]*"|font-family: [^;]*; '
        r'| transform="rotate\(-?0 [^"]*"'
    )
    svg = re.sub(invisible, "", svg, flags=re.S)
    svg = re.sub(r"\s*\n\s*", " ", svg).replace("> <", "><")
    path = r'(?<= )d="[^"]*"'
    svg = re.sub(path, lambda found: re.sub(r" ?([MLQCz]) ?", r"\1", found[0]), svg)
    style = r'(?<= )style="[^"]*"'
    return re.sub(style, lambda found: re.sub(r"([:;]) ", r"\1", found[0]), svg)
