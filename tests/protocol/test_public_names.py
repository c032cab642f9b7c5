"""The public names of each package load, and the stub that lists them is the only list."""

import importlib

import pytest


@pytest.mark.parametrize("package", ["wrongturn_protocol", "wrongturn_client", "wrongturn_networks", "wrongturn_sim"])
def test_every_public_name_loads(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        module.no_such_name  # noqa: B018
