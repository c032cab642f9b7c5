"""Runners reach the service wherever it listens."""

import socket
from urllib.parse import urlsplit

import pytest

from wrongturn_service.address import AddressError, bind
from wrongturn_service.server import own_url


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "0.0.0.0", "::1", "::"])
def test_the_service_is_reached_at_its_own_url(host: str) -> None:
    try:
        listening = bind(host, 0)
    except AddressError as error:
        pytest.skip(str(error))  # a machine without IPv6
    with listening:
        url = urlsplit(own_url(listening))
        assert url.scheme == "http"
        assert url.hostname not in {"0.0.0.0", "::"}
        assert url.port == listening.getsockname()[1]
        with socket.create_connection((url.hostname, url.port), timeout=120) as caller:
            answered, peer = listening.accept()
            with answered:
                assert peer[:2] == caller.getsockname()[:2] or listening.family is socket.AF_INET6
