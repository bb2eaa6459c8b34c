# SPDX-License-Identifier: Apache-2.0
"""Make the site of all pages and docstrings: `make site`.

MkDocs wants all pages below one folder, without its own settings. So the pages are copied, with
what they link to, and a page is written for each module; README.md is the first one.
"""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "build/site_pages"
COPIED = (
    "README.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "docs",
    "config",
)
LINKED = ("examples", "bags/README.md", "benchmark/README.md")  # by the pages
PACKAGES = ("wam_power_ros", "hardware_sim")
STYLE = ".md-grid {max-width: 76rem} .md-typeset table:not([class]) {font-size: .68rem}\n"


def copy() -> None:
    """Copy the pages and what they link to."""
    shutil.rmtree(PAGES, ignore_errors=True)
    for name in (*COPIED, *LINKED):
        target = PAGES / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, target)
    (PAGES / "docs/style.css").write_text(STYLE)


def modules() -> None:
    """A page for each module, and one that lists them."""
    first = (
        "Begin with [learning.skill](wam_power_ros.learning.skill.md): `fit`, `path`, `practise`."
    )
    lines = ["# Library", "", "Every module, class and function, from the docstrings.", first, ""]
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(part for part in parts if part != "__init__")
            if "__main__" in parts:
                continue
            (PAGES / "api").mkdir(exist_ok=True)
            (PAGES / f"api/{name}.md").write_text(f"# {name}\n\n::: {name}\n")
            depth = name.count(".")
            lines.append(f"{'    ' * depth}* [{name.rpartition('.')[2]}]({name}.md)")
    (PAGES / "api/index.md").write_text("\n".join(lines) + "\n")


def main() -> int:
    """Write site/, and fail if a link leads nowhere."""
    copy()
    modules()
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", ROOT / "docs/mkdocs.yml"]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
