"""What the tutorial and the how-to pages show is run, each page in a folder of its own; pages and navigation agree.

A ```python block that begins with "# needs PACKAGE" is left out where the package is not installed.
A ```console block holds commands after "$ "; `# exit code N` behind one says how it ends. A ```python block has the
names of the blocks before it. Blocks of other languages (```text, ```sh) are not run.
"""

from __future__ import annotations

import importlib.util
import re
import shlex
import shutil
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from mocodec import cli

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [DOCS / "tutorial.md", *sorted((DOCS / "howto").glob("*.md"))]
BLOCK = re.compile(r"^```(console|python)\n(.*?)^```", re.DOTALL | re.MULTILINE)
NEEDS = re.compile(r"# needs (\w+)\n")
EXIT_CODE = re.compile(r"# exit code (\d+)")


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `mocodec demo` writes, made once: every page begins with it."""
    folder = tmp_path_factory.mktemp("demo") / "demo"
    assert cli.run(["demo", "-o", str(folder)]) == 0
    return folder


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # WebDataset leaves shards open
@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_commands_and_code_run(page: Path, demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib", reason="drawing needs the [plot] extra")
    if page.stem == "point-clouds":
        pytest.importorskip("av", reason="point clouds need the [cloud] extra")
    if page.stem == "arrays":
        for library in ("xarray", "zarr", "pandas", "dask.array", "fsspec"):
            pytest.importorskip(library, reason=f"needs the [{library.split('.')[0]}] extra")
        if not entry_points(group="xarray.backends", name="mocodec"):
            pytest.skip("mocodec is not installed, so that xarray and zarr do not find it")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for language, block in BLOCK.findall(page.read_text()):
        if language == "python":
            needed = NEEDS.match(block)
            if needed and importlib.util.find_spec(needed[1]) is None:
                continue
            exec(compile(block, page.name, "exec"), names)
            continue
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            assert words[:2] == ["$", "mocodec"], line
            if words[2:] == ["demo", "-o", "demo"]:
                shutil.copytree(demo, "demo")
                continue
            code = EXIT_CODE.search(line)
            assert cli.run(words[2:]) == (int(code[1]) if code else 0), line


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text()
    pages = [page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md") if "results" not in page.parts]
    assert [page for page in pages if f" {page}\n" not in navigation] == []


def test_pages_of_the_navigation_exist() -> None:
    for page in re.findall(r"^ +- (?:.*: )?(\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE):
        assert (DOCS / page).exists(), page


def test_inclusions_exist() -> None:
    for page in DOCS.rglob("*.md"):
        for included in re.findall(r"<!-- include (\S+) -->", page.read_text()):
            assert (ROOT / included).exists(), f"{page.name} includes {included}"
