"""The documentation's notebook runs from its first cell to its last in a kernel of its own, and shows what it did."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs/notebooks/first-driver.ipynb"
SECRET = re.compile(r"wt_\w+")


def outputs(notebook: nbformat.NotebookNode, kind: str) -> list[str]:
    """Return all outputs of a kind, as text."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [
        output.data[kind] for cell in cells for output in cell.outputs if output.get("data") and kind in output.data
    ]


def told(notebook: nbformat.NotebookNode) -> str:
    """Return what its cells wrote to stdout and stderr."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return "".join(output.text for cell in cells for output in cell.outputs if output.output_type == "stream")


@pytest.mark.soak
@pytest.mark.system
@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of the kernel's connection
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page of the tutorial trains, exports and drives the same network."""
    for name in ("WRONGTURN_URL", "WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN", "WRONGTURN_OPERATOR_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.read(NOTEBOOK, 4)
    NotebookClient(notebook, timeout=800, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert len(outputs(notebook, "image/png")) == 4  # what the camera sees, and three drives
    evaluation, frame, counts, board = outputs(notebook, "text/html")
    assert "infeasible" in evaluation
    assert frame.count("<tr") == 13
    assert "infeasible" in counts
    assert "first driver" in board
    # Nothing but the bar: no warning of an event loop, of a missing widget or of a deprecated name.
    assert re.sub(r"smoke@3: \[[#.]+\] \d+ of 12 episodes", "", told(notebook)).split() == []
    completed = re.search(r"(\d)/6\s*\n", evaluation)
    assert completed is not None
    assert int(completed[1]) >= 1


def test_the_notebook_shows_outputs_without_traces_of_a_machine() -> None:
    notebook = nbformat.read(NOTEBOOK, 4)
    assert len(outputs(notebook, "image/png")) == 4
    assert len(outputs(notebook, "text/html")) == 4
    shown = told(notebook) + "".join(outputs(notebook, "text/plain"))
    assert "12 of 12 episodes" in shown
    assert "/home/" not in shown
    assert "/tmp/" not in shown
    assert not SECRET.search(NOTEBOOK.read_text("utf-8"))


def test_its_network_is_the_tutorials() -> None:
    tutorial = (ROOT / "docs/tutorial.md").read_text("utf-8")
    source = "\n".join(cell.source for cell in nbformat.read(NOTEBOOK, 4).cells)
    network = re.search(r"^class PathAhead.*?(?=\n```)", tutorial, re.DOTALL | re.MULTILINE)
    assert network is not None
    assert network[0].rstrip() in source
