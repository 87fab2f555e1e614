"""A page: one self-contained file, made of parts."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from markupsafe import Markup

from stringcast.stages.report import formatting
from stringcast.stages.report.parts import (
    ASSET_FOLDER,
    Card,
    Commands,
    Details,
    Part,
    Section,
    html_templates,
    settings_table,
)
from stringcast.stages.report.records import StageRecord
from stringcast.stages.report.theme import CSS_VARIABLES

# scripts of a page with an element of each class
SCRIPTS_OF_CLASS = {
    "explore": ("vendor/uPlot.iife.min.js", "explore.js"),
    "here": ("vendor/uPlot.iife.min.js", "explore.js"),
    "runs": ("runs.js",),
}
MIN_SECTIONS_WITH_CONTENTS = 4
# source of a run's data, by its hardware
SOURCES = {
    "hardware.virtual.open_lab": "simulated in a virtual lab",
    "hardware.serial.rehearsal.open_lab": "an emulated arm in a virtual lab",
    "hardware.serial.lab.open_lab": "an arm on a serial port",
    "hardware.dynamixel.lab.open_lab": "an arm of Dynamixel servos",
}


@dataclass(frozen=True)
class Page:
    """A self-contained page, whose HTML is `str(page)`.

    kind: subject, such as sweep. origin: seed, if any, code, packages. settings: nested
    blocks. tone: "good" or "bad", for the colour and mark of the heading. nav: anchors
    and words of links; by default, a page of many sections links to each. following:
    purposes and commands to continue with.
    """

    kind: str
    name: str
    heading: str
    lead: str
    sections: Sequence[Part | None]
    origin: Mapping[str, Any]
    settings: Mapping[str, Any]
    tone: str = ""
    nav: Sequence[tuple[str, str]] = ()
    following: Sequence[tuple[str, str]] = ()

    def __str__(self) -> str:
        """Render the page; the same content gives the same HTML."""
        parts = [*self.sections, self._next_steps(), self._reproduction()]
        body = Markup("\n").join(part for part in parts if part is not None)
        names: dict[str, None] = {}
        for kind, scripts_of_kind in SCRIPTS_OF_CLASS.items():
            if f'class="{kind}"' in body:
                names |= dict.fromkeys(scripts_of_kind)
        scripts = [_read_asset(name) for name in names]
        sheet = CSS_VARIABLES + _read_asset("theme.css")
        if "explore.js" in names:
            sheet += _read_asset("vendor/uPlot.min.css")
        return (
            html_templates()
            .get_template("page.html.j2")
            .render(
                page=self,
                body=body,
                policy=Markup(_script_policy(scripts)),
                scripts=map(Markup, scripts),
                sheet=Markup(sheet),
            )
        )

    @property
    def source(self) -> str:
        """Source of the data (simulation, devices, stored trials); empty if unknown."""
        settings = dict(formatting.setting_texts(self.settings))
        trials = settings.get("trials", "null")
        if trials != "null":
            return f"stored trials of {trials}"
        return SOURCES.get(settings.get("hardware._target_", ""), "")

    @property
    def contents(self) -> Sequence[tuple[str, str]]:
        """The links below the heading."""
        if self.nav:
            return self.nav
        sections = [part for part in self.sections if isinstance(part, Section)]
        if len(sections) < MIN_SECTIONS_WITH_CONTENTS:
            return ()
        return [(section.place, section.title) for section in sections]

    def _next_steps(self) -> Section | None:
        if not self.following:
            return None
        return Section("Next steps", [Card("", [Commands(self.following)])])

    def _reproduction(self) -> Section:
        """List the origin of the page, and the settings that reproduce it."""
        seed = f"seed {self.origin['seed']}, " if "seed" in self.origin else ""
        origin = f"Origin: {seed}code {self.origin['code']['commit'][:10]}"
        folded = [Details(origin, [settings_table(self.origin)])]
        if self.settings:
            title = "All settings, by their names on the command line"
            folded.append(Details(title, [settings_table(self.settings)]))
        return Section("How to reproduce this", folded)


def stage_page(
    facts: StageRecord,
    kind: str,
    sections: Sequence[Part | None],
    heading: str = "",
    lead: str = "",
    tone: str = "",
) -> str:
    """Render the page of a stage; heading and lead default to its sentence."""
    page = Page(
        kind=kind,
        name=facts.name,
        heading=heading or facts.sentence,
        lead=lead or facts.sentence,
        sections=sections,
        origin=facts.provenance,
        settings=facts.settings,
        tone=tone,
        following=facts.next_commands,
    )
    return str(page)


def _script_policy(scripts: Sequence[str]) -> str:
    """Return the security policy that allows only these scripts."""
    if not scripts:
        return ""
    digests = [hashlib.sha256(script.encode()).digest() for script in scripts]
    sources = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
    return f"; script-src {' '.join(sources)}"


@cache
def _read_asset(name: str) -> str:
    return (ASSET_FOLDER / name).read_text(encoding="utf-8")
