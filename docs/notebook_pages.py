"""Notebooks as pages of the site: executed while it is built, with what each cell shows."""

from __future__ import annotations

import base64
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nbformat import NotebookNode

__all__ = ["execute", "pages", "shown"]

LONGEST = 1800.0  # [s] that a notebook may take: the first compiles the simulation


def pages(folder: Path, root: Path) -> Iterator[tuple[str, str | bytes]]:
    """(file of the site, content) of each notebook: the page, and the pictures on it."""
    for path in sorted(folder.glob("*.ipynb")):
        text, pictures = shown(execute(path, root), path.stem)
        yield f"notebooks/{path.stem}.md", f"{text}\n\n[The notebook]({path.name})\n"
        for name, data in pictures.items():
            yield f"notebooks/{name}", data


def execute(path: Path, root: Path) -> NotebookNode:
    """The notebook with the outputs of its cells, run in an empty folder. Raises CellExecutionError."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    known = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(root), *([known] if known else [])])  # of the kernel, a process of its own
    try:
        with tempfile.TemporaryDirectory() as work:
            client = NotebookClient(
                notebook, timeout=LONGEST, resources={"metadata": {"path": work}}, extra_arguments=["--log-level=ERROR"]
            )
            return client.execute()
    finally:
        os.environ.pop("PYTHONPATH") if known is None else os.environ.__setitem__("PYTHONPATH", known)


def shown(notebook: NotebookNode, stem: str) -> tuple[str, dict[str, bytes]]:
    """Markdown of a notebook that was executed, and its pictures (PNG) by name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            image = output.get("data", {}).get("image/png")
            if image is not None:
                name = f"{stem}_{len(pictures)}.png"
                pictures[name] = base64.b64decode(image)
                parts.append(f"![What the cell above draws]({name})")
            elif text := _text(output):
                parts.append(f"```text\n{text}\n```")
    return "\n\n".join(parts), pictures


def _text(output: Any) -> str:
    """What an output prints; nothing of standard error, where progress goes."""
    if output.output_type == "stream":
        return str(output.text).rstrip() if output.name == "stdout" else ""
    return str(output.get("data", {}).get("text/plain", "")).rstrip()
