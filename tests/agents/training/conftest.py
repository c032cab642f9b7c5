from collections.abc import Iterator

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")


@pytest.fixture(scope="package", autouse=True)
def one_thread() -> Iterator[None]:
    """Such small batches are slower with threads that wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
