"""What the site has beside the pages of docs/: the README, examples/, the measurements.

Links are written for a reader of the repository, so that they work on GitHub, and are changed here.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = [path.relative_to(ROOT) for path in sorted((ROOT / "benchmarks").glob("*.md"))]


def relink(text: str, up: str) -> str:
    """The links of a page, moved to the site.

    Args:
        text: the page.
        up: the path from the page to the root of the repository: "" or "../".
    """
    text = re.sub(rf"\]\({up}examples/(\w+)\.py\)", r"](examples.md#\1)", text)
    if not up:
        text = text.replace("](docs/", "](").replace('src="docs/', 'src="')
    return text.replace(f"]({up}benchmarks/", "](benchmarks/")


def examples() -> str:
    """The page with the programs of examples/."""
    parts = ["# Examples", "Each program is tested on every change. Run one from a checkout."]
    for path in sorted((ROOT / "examples").glob("*.py")):
        parts += [f"## {path.stem} {{ #{path.stem} }}"]
        parts += [f"```python\n{path.read_text(encoding='utf-8')}```"]
    return "\n\n".join(parts) + "\n"


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not files of docs/."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "index.md", content=relink(readme, "")))
    files.append(File.generated(config, "examples.md", content=examples()))
    for path in [*BENCHMARKS, Path("benchmarks/scaling.svg")]:
        files.append(File.generated(config, str(path), abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Change the links of a page of docs/."""
    return relink(markdown, "../")
