"""What the site has beside the pages of docs/: the README, the lesson, examples/, measurements.

Links are written for a reader of the repository, so that they work on GitHub, and are changed here.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient
from nbconvert import MarkdownExporter

ROOT = Path(__file__).resolve().parents[1]
LESSON = ROOT / "lesson"
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


def executed() -> nbformat.NotebookNode:
    """The lesson, run from top to bottom; kept in build/ until one of its files changes."""
    files = sorted(path for path in LESSON.iterdir() if path.is_file())
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]
    kept = ROOT / "build" / f"lesson-{digest}.ipynb"
    if not kept.is_file():
        notebook = nbformat.read(LESSON / "lesson.ipynb", 4)
        NotebookClient(notebook, timeout=600, resources={"metadata": {"path": LESSON}}).execute()
        kept.parent.mkdir(exist_ok=True)
        nbformat.write(notebook, kept)
    return nbformat.read(kept, 4)


def lesson(files: Files, config: Any) -> None:
    """Add the page of the executed lesson, its pictures, and the page of its solutions."""
    text, resources = MarkdownExporter().from_notebook_node(executed())
    text = re.sub(r"<style scoped>.*?</style>", "", text, flags=re.DOTALL)
    text = text.replace('<table border="1" class="dataframe">', "<table>")
    for name, picture in resources["outputs"].items():
        files.append(File.generated(config, f"lesson/{name}", content=picture))
        text = text.replace(f"]({name})", f"](lesson/{name})")
    files.append(File.generated(config, "lesson.md", content=text.lstrip()))
    solved = (LESSON / "solutions.py").read_text(encoding="utf-8")
    files.append(
        File.generated(config, "solutions.md", content=f"# Solutions\n\n```python\n{solved}```\n")
    )


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not files of docs/."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "index.md", content=relink(readme, "")))
    files.append(File.generated(config, "examples.md", content=examples()))
    for path in [*BENCHMARKS, Path("benchmarks/scaling.svg")]:
        files.append(File.generated(config, str(path), abs_src_path=str(ROOT / path)))
    lesson(files, config)
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Change the links of a page of docs/."""
    return relink(markdown, "../")
