"""Read a page as a reader and a browser see it."""

import base64
import json
import re
from html.parser import HTMLParser

import pytest

VOID = {"meta", "img", "input", "br", "link"}


class Page(HTMLParser):
    """Elements, visible text and scripts of a page; raises if tags are not nested."""

    def __init__(self, text):
        super().__init__()
        self.open, self.elements, self.words = [], [], []
        self.scripts, self.styles = [], []
        self.feed(text)
        assert self.open == [], f"never closed: {self.open}"
        self.text = re.sub(r"\s+", " ", " ".join(self.words))

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        inside = self.open[-1] if self.open else ""
        texts = {"script": self.scripts, "style": self.styles}
        texts.get(inside, self.words).append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    def drawings(self):
        """Return the SVG pictures by their descriptions."""
        return {
            image["alt"]: decode_image(image["src"]).decode()
            for image in self.all("img")
            if "svg+xml" in image["src"]
        }

    def explored(self):
        """Return the data of films and charts; NaN is refused, as by JSON.parse."""
        data = [
            json.loads(text, parse_constant=pytest.fail)
            for text in self.scripts
            if text.startswith("{")
        ]
        charts = [one for one in data if "lines" in one]
        return [one for one in data if "strings" in one], charts

    def require_complete(self):
        """Fail if the page or a drawing loads anything from elsewhere."""
        for tag, attributes in self.elements:
            assert tag not in {"link", "iframe"}
            assert tag != "script" or set(attributes) <= {"type"}
            for name in ("src", "href", "srcset", "poster", "action", "data"):
                where = attributes.get(name) or "#"
                message = f"<{tag} {name}={where[:60]}>"
                assert where.startswith(("data:image/", "#")), message
        assert not re.search(r"url\(|@import", " ".join(self.styles))
        assert not re.search(r"fetch|import|XMLHttp|https?:", self.scripts[-1])
        elsewhere = r'href="(?!#|data:)|url\((?!#)|<!DOCTYPE|<script'
        for drawing in self.drawings().values():
            assert not re.search(elsewhere, drawing)


def decode_image(source):
    return base64.b64decode(source.partition("base64,")[2])


def fixed_colours(drawing):
    """Return the colours of a drawing that are not theme colours."""
    drawn = re.sub(
        r":root{.*?}|<image[^>]*>|<defs>.*?</defs>", "", drawing, flags=re.DOTALL
    )
    return set(re.findall(r"(?:fill|stroke): ?(#[0-9a-f]{6})", drawn)) - {"#ffffff"}
