"""Build the site: `python -m docs.build`, or `linkcheck` to try links to other sites.

The pages of the site are the pages of the rooms. They are copied, with what they link
to, into one folder from which Sphinx builds. A page in `docs/pages` exists on the site
only.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import stringcast

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "pages"
SITE = ROOT / "docs" / "site"
LINK = re.compile(r"\]\(([^)#\s]+)")
API_INTRODUCTION = """\
# Python interface
Reference: every name that `import stringcast as sc` offers. Lengths are in metres,
times in seconds, angles in radians.
"""


def main(arguments: list[str]) -> int:
    """Build the site with a builder of Sphinx, `html` unless another is named."""
    builder = arguments[0] if arguments else "html"
    source = SITE / "source"
    shutil.rmtree(source, ignore_errors=True)
    for page in tracked_pages():
        collect_page(page, source)
    for page in PAGES.iterdir():
        shutil.copy(page, source / page.name)
    (source / "api.md").write_text(api_page(), encoding="utf-8")

    options = ("--fail-on-warning", "--keep-going", "--quiet", "--jobs", "auto")
    folders = ("-c", ROOT / "docs", source, SITE / builder)
    command = [sys.executable, "-m", "sphinx", "-b", builder, *options, *folders]
    status = subprocess.run(command, cwd=ROOT, check=False).returncode
    if status == 0 and builder == "html":
        number_captions(SITE / builder)
        print(f"The site: {SITE / 'html' / 'index.html'}")
    return status


def tracked_pages() -> list[Path]:
    """Return the pages of all rooms, relative to the clone."""
    command = ["git", "ls-files", "*.md", ":!docs"]
    listed = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [Path(name) for name in listed.stdout.splitlines()]


def collect_page(page: Path, source: Path) -> None:
    """Copy a page and the files that it links to.

    A link to a folder becomes one to the list of its files.
    """
    text = (ROOT / page).read_text(encoding="utf-8")
    for link in LINK.findall(text):
        file = (ROOT / page.parent / link).resolve()
        if link.startswith("http") or file.suffix == ".md":
            continue
        if not file.is_relative_to(ROOT):
            raise SystemExit(f"{page}: the link {link} leaves the project.")
        target = source / file.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        if file.is_dir():
            text = text.replace(f"]({link})", f"]({link}/index.txt)")
            target.mkdir(exist_ok=True)
            names = sorted(path.name for path in file.iterdir())
            (target / "index.txt").write_text("\n".join(names), encoding="utf-8")
        else:
            shutil.copy(file, target)
    target = source / page
    target.parent.mkdir(parents=True, exist_ok=True)
    # a public host draws these; here their text is read
    text = text.replace("```mermaid", "```text")
    target.write_text(text, encoding="utf-8")


def number_captions(site: Path) -> None:
    """Give the captions of the contents a level, which Sphinx leaves out.

    A screen reader needs it for a heading that is a paragraph.
    """
    caption = 'class="caption" role="heading"'
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        text = text.replace(f"{caption}>", f'{caption} aria-level="2">')
        page.write_text(text, encoding="utf-8")


def api_page() -> str:
    """Return the page of the Python interface, made of the docstrings."""
    parts = [API_INTRODUCTION]
    for name in stringcast.__all__:
        exported = getattr(stringcast, name)
        kind = "class" if isinstance(exported, type) else "function"
        if kind == "class" and issubclass(exported, Exception):
            kind = "exception"
        lines = [
            f"## `{name}`",
            "```{eval-rst}",
            f".. auto{kind}:: stringcast.{name}",
        ]
        if kind == "class":
            lines.append("   :members:")
        parts.append("\n".join([*lines, "```"]))
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
