"""Tests that the cached name of each compiled function changes with all files that it was compiled from.

Numba itself looks at a function's own file alone. What else a function is compiled from, the functions that it calls
and the constants that are frozen into it, is found here in the sources, and held against what ``compiled_with`` lists.
"""

import ast
import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest

import wrongturn_judge
import wrongturn_sim

ALWAYS = "wrongturn_judge.compiling"
"""``compiled_with`` is in it and always looks at it. It makes the types of records."""
PROJECT = ("wrongturn_judge", "wrongturn_sim", "wrongturn_protocol", "wrongturn_networks")


@dataclass
class Source:
    """A module as it is written."""

    name: str
    tree: ast.Module
    imported: dict[str, tuple[str, str | None]] = field(default_factory=dict)
    """Local names: the module that they come from and their name there; None for the module itself."""
    bound: dict[str, ast.stmt] = field(default_factory=dict)
    """What each of the module's own names is made by."""


@cache
def source_of(module: str) -> Source:
    spec = importlib.util.find_spec(module)
    assert spec is not None, module
    assert spec.origin is not None, module
    return parsed(module, Path(spec.origin).read_text(encoding="utf-8"))


def parsed(module: str, text: str) -> Source:
    source = Source(module, ast.parse(text))
    for node in source.tree.body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in PROJECT:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                there = (whole, None) if is_module(whole) else (node.module, alias.name)
                source.imported[alias.asname or alias.name] = there
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            source.bound[node.name] = node
        elif isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for name in (one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)):
                source.bound[name] = node
    return source


@cache
def is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def used(node: ast.AST) -> Iterator[tuple[str, str | None]]:
    """Names that are read in a statement, and the attribute that is read of them; annotations are not compiled."""
    if isinstance(node, ast.FunctionDef):
        parts: list[ast.AST] = list(node.body)
    elif isinstance(node, ast.AnnAssign):
        parts = [] if node.value is None else [node.value]
    else:
        parts = [node]
    for part in parts:
        for one in ast.walk(part):
            if isinstance(one, ast.Attribute) and isinstance(one.value, ast.Name):
                yield one.value.id, one.attr
            elif isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load):
                yield one.id, None


def made_from(source: Source, node: ast.AST, seen: set[tuple[str, str]]) -> set[str]:
    """Return the other modules whose text affects the value of a statement."""
    found: set[str] = set()
    for name, attribute in used(node):
        if name in source.imported:
            module, there = source.imported[name]
            there = attribute if there is None else there
            if there is not None:
                found |= reached(module, there, seen)
        elif name in source.bound and (source.name, name) not in seen:
            seen.add((source.name, name))
            found |= made_from(source, source.bound[name], seen)
    return found


def reached(module: str, name: str, seen: set[tuple[str, str]]) -> set[str]:
    if (module, name) in seen:
        return set()
    seen.add((module, name))
    source = source_of(module)
    if name in source.imported:  # it is but handed on
        further, there = source.imported[name]
        return reached(further, there, seen) if there is not None else set()
    return {module} | (made_from(source, source.bound[name], seen) if name in source.bound else set())


def kept(source: Source) -> Iterator[tuple[ast.FunctionDef, set[str]]]:
    """Functions that are kept on the disk, and the modules that they are declared to be compiled from."""
    for node in ast.walk(source.tree):
        for call in node.decorator_list if isinstance(node, ast.FunctionDef) else ():
            if not isinstance(call, ast.Call):
                continue
            decorator = ast.unparse(call.func)
            if decorator == "compiled_with":
                named = [source.imported[ast.unparse(argument)] for argument in call.args]
                yield node, {module for module, there in named if there is None} | {ALWAYS}
            elif decorator.rpartition(".")[2] in {"njit", "jit", "vectorize", "guvectorize"}:
                cached = {word.arg: word.value for word in call.keywords}.get("cache")
                if cached is not None and ast.unparse(cached) != "False":
                    yield node, set()


def undeclared(source: Source) -> dict[str, list[str]]:
    """What cached functions are compiled from beyond their own file and what they declare."""
    found = {}
    for function, declared in kept(source):
        lacking = made_from(source, function, {(source.name, function.name)}) - declared - {source.name}
        if lacking:
            found[function.name] = sorted(lacking)
    return found


MODULES = sorted(
    ".".join(path.relative_to(Path(package.__file__).parents[1]).with_suffix("").parts)
    for package in (wrongturn_judge, wrongturn_sim)
    for path in Path(package.__file__).parent.rglob("*.py")
    if any(word in path.read_text(encoding="utf-8") for word in ("cache=", "compiled_with"))
)


@pytest.mark.parametrize("module", MODULES)
def test_cached_functions_declare_all_that_they_are_compiled_from(module):
    assert undeclared(source_of(module)) == {}


def test_it_looks_at_all_compiled_functions():
    functions = {f"{module}.{one.name}" for module in MODULES for one, _ in kept(source_of(module))}
    assert {
        "wrongturn_sim.camera.raycast.pictures_into",
        "wrongturn_sim.fleet.kernel.run",
        "wrongturn_judge.decide.decide",
    } <= functions
    assert len(functions) > 20


@pytest.mark.parametrize(
    ("lines", "lacking"),
    [
        ("@njit(cache=True)\ndef f(x):\n    return project(x)", ["wrongturn_sim.polyline"]),
        ("@njit(cache=True)\ndef f(x):\n    return polyline.project(x)", ["wrongturn_sim.polyline"]),
        (
            "@njit(cache=True)\ndef f(x):\n    return g(x)\n@njit()\ndef g(x):\n    return project(x)",
            ["wrongturn_sim.polyline"],
        ),
        ("TWICE = 2 * HIT\n@njit(cache=True)\ndef f(x):\n    return x & TWICE", ["wrongturn_judge.kernels"]),
        ("@compiled_with(polyline)\ndef f(x):\n    return project(x) & HIT", ["wrongturn_judge.kernels"]),
    ],
)
def test_it_finds_what_is_not_declared(lines, lacking):
    imports = (
        "from wrongturn_sim import polyline\n"
        "from wrongturn_sim.polyline import project\n"
        "from wrongturn_judge.kernels import HIT\n"
    )
    assert undeclared(parsed("made_up", imports + lines)) == {"f": lacking}
