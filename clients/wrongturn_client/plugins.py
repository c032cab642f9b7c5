"""Commands, lists and checks that other packages add as entry points; each is loaded on first use."""

import ast
import importlib
import importlib.util
import inspect
import shlex
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import typer
from typer.core import TyperCommand, TyperGroup

from wrongturn_client.errors import PluginError
from wrongturn_client.option_errors import describe_option_error
from wrongturn_protocol.json_output import with_stdout

COMMANDS: Final = "wrongturn.commands"
LISTINGS: Final = "wrongturn.listings"
CHECKS: Final = "wrongturn.checks"
TOWNS: Final = "wrongturn.towns"
_USAGE: Final = 2
_PARTS: Final = {
    "wrongturn-networks": ("trials",),
    "wrongturn-service": ("picture",),
    "wrongturn-service[server]": ("backup", "restore", "serve"),
    "wrongturn-agents": ("export", "register", "results", "run", "score", "train"),
}
"""Commands that our other parts add, to tell which part is missing."""


def entry_points(group: str) -> dict[str, metadata.EntryPoint]:
    """Return the entry points of a group by name, in alphabetical order."""
    found = metadata.entry_points(group=group)
    return {point.name: point for point in sorted(found, key=lambda point: point.name)}


def load(point: metadata.EntryPoint) -> Any:
    """Load the object that an entry point names.

    Raises:
        PluginError: It cannot be loaded.
    """
    try:
        return point.load()
    except Exception as error:
        distribution = point.dist.name if point.dist is not None else "its package"
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise PluginError(
            f"{point.name!r} of {distribution} ({point.value}) cannot be loaded: {reason}; "
            f"install {distribution} again, or run 'wrongturn doctor'",
        ) from error


def summary(point: metadata.EntryPoint) -> str:
    """Return the first line of the docstring of an entry point's object, read from its source without running it."""
    try:
        path = _source(point.module)
        tree = ast.parse(path.read_text(encoding="utf-8")) if path is not None else ast.Module([], [])
    except (OSError, SyntaxError, ImportError, ValueError):
        return ""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == point.attr:
            return (ast.get_docstring(node) or "").partition("\n")[0]
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == point.attr for t in node.targets):
            return _help_keyword(node.value)
    return ""


def _source(module: str) -> Path | None:
    """Return the file of a module, found without importing the packages that contain it."""
    package, *rest = module.split(".")
    spec = importlib.util.find_spec(package)
    if spec is None:
        return None
    folders = spec.submodule_search_locations
    if not rest or folders is None:
        return Path(spec.origin) if spec.origin else None
    for folder in folders:
        base = Path(folder, *rest)
        for path in (base.with_suffix(".py"), base / "__init__.py"):
            if path.is_file():
                return path
    return None


def _help_keyword(call: ast.expr) -> str:
    """Return the ``help=`` of a ``typer.Typer(…)``."""
    if isinstance(call, ast.Call):
        for keyword in call.keywords:
            if keyword.arg == "help" and isinstance(keyword.value, ast.Constant):
                return str(keyword.value.value)
    return ""


class LazyCommand(TyperCommand):
    """Command of another package. Its help line is known; the rest is loaded when it is called."""

    entry_point: metadata.EntryPoint

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Load the command and return its context."""
        return self._command().make_context(info_name, args, parent, **extra)

    def _command(self) -> Any:
        target = load(self.entry_point)
        if isinstance(target, typer.Typer):
            return typer.main.get_command(target)
        app = typer.Typer(add_completion=False, rich_markup_mode="rich")
        app.command(self.name, help=inspect.getdoc(target))(target)
        return typer.main.get_command(app)


class PluginGroup(TyperGroup):
    """Commands of the program: its own, then those of other packages."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse a command line, in which each ``--json`` without a file stands for stdout."""
        return super().parse_args(ctx, with_stdout(args))

    def invoke(self, ctx: Any) -> Any:
        """Run the command. For an invalid option value, print one line on stderr and exit with status 2."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            if type(error) is not typer.BadParameter:  # a missing value: the usage message says more
                raise
            typer.echo(f"{ctx.info_name}: {describe_option_error(error)}", err=True)
            raise typer.Exit(_USAGE) from None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return a command with its arguments. For a command of a part that is missing, say which part adds it."""
        if self.get_command(ctx, args[0]) is None:
            for part, commands in _PARTS.items():
                if args[0] in commands:
                    ctx.fail(f"No such command '{args[0]}' here. It comes with {part}: pip install {shlex.quote(part)}")
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands, in the order of the help."""
        own = super().list_commands(ctx)
        return [*own, *(name for name in entry_points(COMMANDS) if name not in own)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name; None if there is none."""
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        point = entry_points(COMMANDS).get(cmd_name)
        if point is None:
            return None
        command = LazyCommand(cmd_name, help=summary(point) or f"See 'wrongturn {cmd_name} --help'.")
        command.entry_point = point
        return command


def checks() -> Iterator[tuple[str, bool, str, str]]:
    """Run the checks of other packages; yield name, whether it passed, detail and remedy of each."""
    for name, point in entry_points(CHECKS).items():
        try:
            yield from load(point)()
        except PluginError as error:
            yield name, False, str(error), "install it again"
        except Exception as error:
            yield name, False, f"the check itself failed: {type(error).__name__}: {error}", "install it again"
    for name, point in entry_points(COMMANDS).items():
        try:
            load(point)
        except PluginError as error:
            yield f"command {name}", False, str(error), "install it again"
