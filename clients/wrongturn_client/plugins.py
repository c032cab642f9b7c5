"""Commands, lists and checks that other packages add as entry points; each is loaded on first use."""

import ast
import importlib.util
import inspect
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import typer
from typer.core import TyperCommand, TyperGroup

from wrongturn_client.errors import PluginError
from wrongturn_protocol.installing import install
from wrongturn_protocol.json_output import with_stdout
from wrongturn_protocol.suggestions import did_you_mean

COMMANDS: Final = "wrongturn.commands"
LISTINGS: Final = "wrongturn.listings"
CHECKS: Final = "wrongturn.checks"
LOADERS: Final = "wrongturn.loaders"
_USAGE: Final = 2
_PARTS: Final = {
    "wrongturn-networks": ("trials",),
    "wrongturn-service": ("judge", "picture"),
    "wrongturn-service[server]": ("backup", "restore", "serve"),
    "wrongturn-agents": ("export", "register", "results", "run", "score", "train", "whatif"),
    "wrongturn-openenv": ("openenv",),
    "wrongturn-certificates": ("verify",),
    "wrongturn-statistics": ("dose", "effects", "power"),
}
"""Commands that our other parts add, to tell which part is missing."""
_NUMBERS: Final = {
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
}
"""What to give instead, by the type of pydantic's error; typer reads values with pydantic."""


def entry_points(group: str) -> dict[str, metadata.EntryPoint]:
    """Return the entry points of a group by name, in alphabetical order."""
    return {point.name: point for point in sorted(metadata.entry_points(group=group), key=lambda point: point.name)}


def load(point: metadata.EntryPoint) -> Any:
    """Load the object that an entry point names; raise PluginError if that fails."""
    try:
        return point.load()
    except Exception as error:
        distribution = point.dist.name if point.dist is not None else "its package"
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise PluginError(
            f"{point.name!r} of {distribution} ({point.value}) cannot be loaded: {reason}; "
            f"install {distribution} again, or run 'wrongturn doctor'"
        ) from error


def summary(point: metadata.EntryPoint) -> str:
    """Return a command's help line, read from its source: to import every command takes seconds."""
    package, *inner = point.module.split(".")
    try:
        spec = importlib.util.find_spec(package)
        folder = Path(spec.origin).parent if spec is not None and spec.origin else Path()
        tree = ast.parse(folder.joinpath(*inner).with_suffix(".py").read_text(encoding="utf-8"))
    except (OSError, SyntaxError, ValueError):
        return ""
    for node in tree.body:
        match node:
            case ast.FunctionDef(name=point.attr):
                return (ast.get_docstring(node) or "").partition("\n")[0]
            case ast.Assign(targets=[ast.Name(id=point.attr)], value=ast.Call(keywords=keywords)):
                return next((str(ast.literal_eval(one.value)) for one in keywords if one.arg == "help"), "")
    return ""


class LazyCommand(TyperCommand):
    """Command of another package. Its help line is known; the rest is loaded when it is called."""

    entry_point: metadata.EntryPoint

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Load the command and return its context."""
        return self.loaded().make_context(info_name, args, parent, **extra)

    def loaded(self) -> Any:
        """Return the command itself."""
        target = load(self.entry_point)
        if not isinstance(target, typer.Typer):
            app = typer.Typer(add_completion=False, rich_markup_mode="rich")
            app.command(self.name, help=inspect.getdoc(target))(target)
            target = app
        return typer.main.get_command(target)


def lazy_command(point: metadata.EntryPoint) -> LazyCommand:
    """Return the command that an entry point names."""
    command = LazyCommand(point.name, help=summary(point) or f"See 'wrongturn {point.name} --help'.")
    command.entry_point = point
    return command


class PluginGroup(TyperGroup):
    """Commands of the program: its own, then those of other packages."""

    plugins = COMMANDS
    """Entry-point group of the commands of other packages."""

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
            typer.echo(f"{ctx.info_name}: {_described(error)}", err=True)
            raise typer.Exit(_USAGE) from None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return a command with its arguments. For an unknown one, name the part that adds it, or the one meant."""
        if self.get_command(ctx, args[0]) is None:
            unknown = f"No such command '{args[0]}'"
            for part, commands in _PARTS.items():
                if args[0] in commands:
                    ctx.fail(f"{unknown} here. It comes with {part}: {install(part)}")
            ctx.fail(unknown + (did_you_mean(args[0], self.list_commands(ctx)) or "."))
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands, in the order of the help."""
        return list(dict.fromkeys([*super().list_commands(ctx), *entry_points(self.plugins)]))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name; None if there is none."""
        own = super().get_command(ctx, cmd_name)
        point = None if own is not None else entry_points(self.plugins).get(cmd_name)
        if point is None:
            return own
        return lazy_command(point)


class ListingGroup(PluginGroup):
    """Commands about things of a sort; without the name of one, the command ``list``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse a command line; what is no command is an argument of ``list``."""
        known = {*self.list_commands(ctx), *ctx.help_option_names}
        return super().parse_args(ctx, args if args and args[0] in known else ["list", *args])


class TownCommands(ListingGroup):
    """Commands about towns."""

    plugins = "wrongturn.commands.towns"


class SuiteCommands(ListingGroup):
    """Commands about suites."""

    plugins = "wrongturn.commands.suites"


def checks() -> Iterator[tuple[str, bool, str, str]]:
    """Run the checks of other packages; yield name, whether it passed, detail and remedy of each."""
    for name, point in entry_points(CHECKS).items():
        try:
            yield from load(point)()
        except PluginError as error:
            yield name, False, str(error), "install it again"
        except Exception as error:
            yield name, False, f"the check itself failed: {type(error).__name__}: {error}", "install it again"
    groups = (PluginGroup, TownCommands, SuiteCommands)
    for name, point in (one for group in groups for one in entry_points(group.plugins).items()):
        try:
            load(point)
        except PluginError as error:
            yield f"command {name}", False, str(error), "install it again"


def _described(error: typer.BadParameter) -> str:
    """Return one line with the option, the value that was given, and what to give instead."""
    option: Any = error.param
    name = max(option.opts, key=len) if option is not None else error.param_hint or "option"
    errors = getattr(error.__cause__, "errors", None)
    first = errors(include_url=False)[0] if errors is not None else {"type": "", "input": ""}
    wanted, given = _NUMBERS.get(first["type"]), repr(str(first["input"])[:40])
    if first["type"] in {"greater_than_equal", "less_than_equal"}:
        whole = all(bound is None or isinstance(bound, int) for bound in (option.min, option.max))
        wanted, given = "a whole number" if whole else "a number", first["input"]
    if wanted is None:
        message = error.message.removeprefix("Value error, ").rstrip(".").replace("\n", " ")
        return f"{name}: {message}"
    return f"{name}: is {given}; give {wanted}{_range(option)}"


def _range(option: Any) -> str:
    least, most = option.min, option.max
    if least is None:
        return "" if most is None else f", {most} or less"
    return f", {least} or more" if most is None else f" from {least} to {most}"
