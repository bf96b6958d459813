"""Import rules, checked for every import statement: layers of docs/architecture.md, no cycles, no benchmarks."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import mocodec

PACKAGE = Path(mocodec.__file__).parent
ROOT = Path(__file__).resolve().parents[1]

# From top to bottom. A part may import the parts below it, and those in its row unless the row is in APART.
LAYERS = (
    ("cli", "__main__"),
    ("viewer",),
    ("testing", "plots", "cloud_plots"),
    ("torch", "learning", "arrays"),
    ("archive",),
    ("api", "opened", "packing", "in_pieces", "decoded_chunks"),
    ("codecs", "container"),
    ("signals",),
    ("stages", "entropy", "fields", "geometry", "formats", "metrics"),
    (
        "motion",
        "skeleton",
        "pointcloud",
        "encoded",
        "errors",
        "data",
        "native",
        "parallel",
        "progress",
        "selection",
        "typing",
        "channels",
        "file_range",
    ),
)
APART = {("codecs", "container"), ("testing", "plots")}


def part(parts: tuple[str, ...]) -> str:
    """The part of the package that a module belongs to: its first name below mocodec."""
    return parts[0] if parts else ""


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """(line, part of mocodec) of every import of mocodec in a file, also inside functions."""
    module = path.relative_to(PACKAGE).with_suffix("").parts
    here = module[:-1] if module[-1] == "__init__" else module
    parent = module[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            targets = [
                tuple(alias.name.split(".")[1:]) for alias in node.names if alias.name.split(".")[0] == "mocodec"
            ]
        elif isinstance(node, ast.ImportFrom) and node.level:
            base = parent[: len(parent) - node.level + 1]
            named = tuple(node.module.split(".")) if node.module else ()
            targets = [(*base, *named)] if named or base else [(alias.name,) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "mocodec":
            named = tuple(node.module.split(".")[1:])
            targets = [named] if named else [(alias.name,) for alias in node.names]
        else:
            continue
        for target in targets:
            if part(target) != part(here):
                yield node.lineno, part(target)


def may_import(importer: str, imported: str) -> bool:
    """Whether the layers allow it; the version may be read from anywhere."""
    if imported == "__version__":
        return True
    row = {name: number for number, names in enumerate(LAYERS) for name in names}
    if row[importer] == row[imported]:
        return LAYERS[row[importer]] not in APART
    return row[importer] < row[imported]


def test_every_part_has_a_layer() -> None:
    known = {name for row in LAYERS for name in row} | {"__init__"}
    found = {p.stem for p in PACKAGE.glob("*.py")} | {p.parent.name for p in PACKAGE.glob("*/__init__.py")}
    assert found <= known, f"give these a place in LAYERS: {sorted(found - known)}"


def test_imports_point_down_only() -> None:
    wrong = []
    for path in sorted(PACKAGE.rglob("*.py")):
        importer = part(path.relative_to(PACKAGE).with_suffix("").parts)
        if importer == "__init__":
            continue
        wrong += [
            f"{path.relative_to(PACKAGE)}:{line} ({importer}) imports {imported}"
            for line, imported in imports(path)
            if imported and not may_import(importer, imported)
        ]
    assert not wrong, "\n".join(wrong)


def test_the_rule_itself() -> None:
    assert may_import("cli", "codecs")
    assert may_import("codecs", "stages")
    assert may_import("stages", "entropy")
    assert may_import("codecs", "fields")
    assert may_import("container", "fields")
    assert not may_import("codecs", "container")
    assert not may_import("stages", "codecs")
    assert not may_import("motion", "metrics")


def imported_modules(path: Path, name: str, modules: set[str]) -> set[str]:
    """The modules of a package that one of its modules imports, inside functions too.

    `from . import name` counts as an import of the module `name` if there is one, otherwise of the package itself.
    """
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    found = set[str]()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *(node.module or "").split(".")]).strip(".")
            for alias in node.names:
                submodule = f"{source}.{alias.name}"
                found.add(submodule if submodule in modules else source)
    return found & modules - {name}


def cycles(folder: Path) -> list[set[str]]:
    """Groups of a package's modules that import each other, directly or through others."""
    files = {
        ".".join((folder.name, *path.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__"): path
        for path in folder.rglob("*.py")
    }
    reached = {name: imported_modules(path, name, set(files)) for name, path in files.items()}
    for middle in files:  # transitive closure
        for name in files:
            if middle in reached[name]:
                reached[name] |= reached[middle]
    groups = {frozenset(other for other in reached[name] if name in reached[other]) for name in files}
    return sorted((set(group) for group in groups if group), key=sorted)


def test_no_import_cycles() -> None:
    assert cycles(PACKAGE) == []


@pytest.mark.skipif(not (ROOT / "benchmarks").is_dir(), reason="no benchmarks beside the tests")
def test_no_import_cycles_in_benchmarks() -> None:
    assert cycles(ROOT / "benchmarks") == []


def test_cycles_are_found(tmp_path: Path) -> None:
    package = tmp_path / "p"
    package.mkdir()
    for name, text in (("__init__", "from .a import x"), ("a", "from . import b"), ("b", "def f(): from p.a import x")):
        (package / f"{name}.py").write_text(text)
    assert cycles(package) == [{"p.a", "p.b"}]


def test_neither_package_nor_tests_import_benchmarks() -> None:
    for path in (*PACKAGE.rglob("*.py"), *(ROOT / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not any(name.split(".")[0] == "benchmarks" for name in names), path
