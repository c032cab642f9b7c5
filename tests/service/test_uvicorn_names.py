"""The private names of uvicorn's that the service's connections use; ``service/pyproject.toml`` has tested versions."""

import ast
import inspect

import pytest
import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from wrongturn_service.socket.guards import GuardedHttp, GuardedWriting
from wrongturn_service.socket.protocol import DirectWebSocket


def _names(kind: type, *, stored: bool) -> set[str]:
    """The attributes of ``self`` that a class sets, or that it reads and calls."""
    return {
        node.attr
        for node in ast.walk(ast.parse(inspect.getsource(kind)))
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "self"
        and (stored == isinstance(node.ctx, ast.Store))
    }


@pytest.mark.parametrize(
    ("base", "ours"),
    [(WebSocketsSansIOProtocol, (DirectWebSocket, GuardedWriting)), (HttpToolsProtocol, (GuardedHttp, GuardedWriting))],
)
def test_uvicorn_has_the_names_that_the_service_extends(base: type, ours: tuple[type, ...]) -> None:
    what = f"uvicorn {uvicorn.__version__}: {base.__name__}"
    advice = "adapt wrongturn_service/socket to it, or narrow the versions in service/pyproject.toml"
    theirs = _names(base, stored=True) | set(vars(base))
    own = set().union(*(vars(kind).keys() for kind in ours), *(_names(kind, stored=True) for kind in ours))
    for kind in ours:
        missing = _names(kind, stored=False) - own - theirs
        assert not missing, f"{what} has no {', '.join(sorted(missing))}; {advice}"
        for name, method in vars(kind).items():
            if getattr(method, "__override__", False):
                of_ours = any(name in vars(each) for each in ours if each is not kind)
                if name not in theirs and of_ours:
                    continue
                assert name in theirs, f"{what} has no {name}; {advice}"
                parameters = list(inspect.signature(vars(base)[name]).parameters)
                expected = list(inspect.signature(method).parameters)
                assert parameters == expected, f"{what}.{name} takes {parameters}, not {expected}; {advice}"
