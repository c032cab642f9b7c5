import pytest
import torch

from wrongturn_marln.replay import Decisions, Replay

GAMMA = 0.5


def made(size=40, cars=2, n_step=3, exponent=1.0):
    return Replay(size, cars, 1, n_step=n_step, gamma=GAMMA, exponent=exponent, dtype=torch.float32)


def driven(time, reward=0.0, ended=(False, False), cut=(False, False)):
    """Two cars: their features tell time and car."""
    cars = torch.arange(2)
    return Decisions(
        features=(10.0 * time + cars).unsqueeze(1),
        measured=torch.zeros(2, 2),
        command=torch.full((2,), time),
        action=cars,
        reward=torch.full((2,), float(reward)),
        ended=torch.tensor(ended),
        cut=torch.tensor(cut),
    )


def everything(replay):
    """What can be replayed, by features."""
    sample = replay.sample(2000, 1.0, torch.Generator().manual_seed(1))
    return {
        int(feature): (returns, following, int(after))
        for feature, returns, following, after in zip(
            sample.now.features[:, 0].tolist(),
            sample.returns.tolist(),
            sample.following.tolist(),
            sample.later.features[:, 0].tolist(),
            strict=True,
        )
    }


def test_returns_of_three_steps():
    replay = made()
    for time in range(6):
        replay.add(driven(time, reward=time))
    found = everything(replay)
    assert sorted(found) == [0, 1, 10, 11, 20, 21]  # the newest three have no whole return yet
    assert found[10] == (1 + 0.5 * 2 + 0.25 * 3, 0.125, 40)
    assert found[21] == (2 + 0.5 * 3 + 0.25 * 4, 0.125, 51)


def test_the_end_of_a_drive_ends_its_returns():
    replay = made()
    for time in range(6):
        replay.add(driven(time, reward=time, ended=(time == 2, False)))
    found = everything(replay)
    assert found[10] == (1 + 0.5 * 2, 0.0, 40)
    assert found[20] == (2.0, 0.0, 50)
    assert found[11] == (1 + 0.5 * 2 + 0.25 * 3, 0.125, 41)


def test_returns_that_time_cut_off_are_not_replayed():
    replay = made()
    for time in range(7):
        replay.add(driven(time, cut=(time == 3, False), ended=(False, time == 2)))
    found = everything(replay)
    assert sorted(one for one in found if one % 10 == 0) == [0]
    # After an end, time that runs out belongs to the next drive.
    assert {1, 11, 21, 31} <= found.keys()


def test_the_oldest_are_replaced():
    replay = made(size=10)
    for time in range(12):
        replay.add(driven(time, reward=time))
    found = everything(replay)
    assert sorted(found) == [70, 71, 80, 81]
    assert found[81] == (8 + 0.5 * 9 + 0.25 * 10, 0.125, 111)
    assert len(replay) == 4


@pytest.mark.parametrize("exponent", [1.0, 0.5, 0.0])
def test_decisions_are_drawn_in_proportion_to_their_priorities(exponent):
    replay = made(exponent=exponent)
    for time in range(5):
        replay.add(driven(time))
    priorities = torch.tensor([1.0, 2.0, 4.0, 9.0])
    replay.update(torch.arange(4), priorities)
    generator = torch.Generator().manual_seed(3)
    sample = replay.sample(40_000, 1.0, generator)
    shares = torch.bincount(sample.places, minlength=4)[:4] / 40_000
    wanted = priorities**exponent / (priorities**exponent).sum()
    assert shares.tolist() == pytest.approx(wanted.tolist(), abs=0.002)
    # Weights undo the proportions: each is 1 / (number * share), divided by the greatest.
    weights = {int(place): weight for place, weight in zip(sample.places, sample.weight.tolist(), strict=True)}
    undone = (1.0 / wanted) / (1.0 / wanted).max()
    assert [weights[place] for place in range(4)] == pytest.approx(undone.tolist(), rel=1e-3)


def test_new_decisions_are_as_likely_as_the_likeliest():
    replay = made()
    for time in range(4):
        replay.add(driven(time))
    replay.update(torch.arange(2), torch.tensor([7.0, 1.0]))
    replay.add(driven(4))
    sample = replay.sample(22_000, 1.0, torch.Generator().manual_seed(3))
    shares = torch.bincount(sample.places, minlength=4)[:4] / 22_000
    assert shares.tolist() == pytest.approx([7 / 22, 1 / 22, 7 / 22, 7 / 22], abs=0.003)
