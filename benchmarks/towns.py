"""How long resets take while the service builds the towns of an evaluation.

    .venv/bin/python benchmarks/towns.py [--rounds 5] [--json FILE] [--short]

One client begins practice episodes in Town01, one after the other, first alone, then while evaluations of
wrong-command-unseen@1 begin, whose ten towns each the service builds in the background. Prints the times of these
resets, and how long each evaluation waited for its first episode. ``--short`` has a round of no evaluation.
"""

import statistics
import tempfile
import threading
import time

from common import finish, parser

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from wrongturn_client import Client, LocalService
from wrongturn_protocol import PracticeRequest, Track

SUITE = "wrong-command-unseen@1"
_ALONE = 30


class Resets:
    """Begins and ends practice episodes, and times how long their first observation takes."""

    def __init__(self, client: Client) -> None:
        self._client, self.ms = client, list[float]()

    def once(self) -> None:
        began = time.perf_counter()
        episode = self._client.practise(PracticeRequest(town="Town01", approach="J12-E", seed=len(self.ms)))
        self.ms.append(1000 * (time.perf_counter() - began))
        self._client.abort_episode(episode.id)

    def take(self) -> dict[str, float]:
        taken, self.ms = self.ms, []
        return {"resets": len(taken), "median_ms": statistics.median(taken), "longest_ms": max(taken)}


def first_episode(client: Client, waited: list[float]) -> None:
    """Begin an evaluation, and wait until its first episode can be driven."""
    began = time.perf_counter()
    evaluation = client.create_evaluation(SUITE)
    client.next_episode(evaluation.id)
    waited.append(time.perf_counter() - began)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--rounds", type=int, default=5)
    given = options.parse_args()
    rounds = 0 if given.short else given.rounds
    waited: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        database = f"sqlite+aiosqlite:///{folder}/wrongturn.db"
        with LocalService(database=database, environment={"WRONGTURN_HOME": folder}) as service:

            def client(name: str) -> Client:
                with Client(service.url) as stranger:
                    return Client(service.url, stranger.register(name, Track.CAMERA).token)

            with client("practises") as practising:
                resets = Resets(practising)
                resets.once()
                resets.take()
                for _ in range(_ALONE):
                    resets.once()
                figures = {"alone": resets.take()}
                for number in range(rounds):
                    with client(f"waits {number}") as waiting:
                        thread = threading.Thread(target=first_episode, args=(waiting, waited))
                        thread.start()
                        while thread.is_alive():
                            resets.once()
                            time.sleep(0.05)
                if rounds:
                    figures["while towns are built"] = resets.take()
    for name, each in figures.items():
        print(
            f"{name}: {each['resets']} resets, median {each['median_ms']:.0f} ms, longest {each['longest_ms']:.0f} ms"
        )
    print("first episode after", ", ".join(f"{each:.1f} s" for each in waited) or "–")
    finish({**figures, "first_episode_s": waited}, given)


if __name__ == "__main__":
    main()
