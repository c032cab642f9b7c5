from made_results import keep, navigation, wrong_command

from wrongturn_agents.algorithms import algorithm_results
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client.plugins import entry_points, load
from wrongturn_networks import load_suite
from wrongturn_protocol import Flag, Track


def test_each_algorithm_has_the_outcomes_of_its_seeds_on_the_open_draw(tmp_path):
    keep(
        tmp_path,
        wrong_command("ppo-image", (0, 0, 2, 0, 0, 0), seed=1, opposed=4),
        wrong_command("ppo-image", (0, 0, 5, 0, 0, 0), seed=3),
        wrong_command("ppo-image", (9,) * 6, seed=1, variant="without-augmentation"),
        wrong_command("ppo-image", (9,) * 6, seed=1, driven="over the service", secret="5ec2e7"),
        wrong_command("careful", (0,) * 6),
        navigation("ppo-image", {}, seed=1),
    )
    (row,) = algorithm_results(WRONG_COMMAND, tmp_path)
    suite = load_suite(WRONG_COMMAND)
    assert (row.name, row.track, row.suite, row.sha256) == ("ppo-image", Track.CAMERA, suite.id, suite.sha256)
    assert set(row.seeds) == {1, 3}
    for outcomes in row.seeds.values():
        assert set(outcomes) == {trial.id for trial in suite.open_draw.episodes}
    assert sum(Flag.OPPOSED_LANE in one.flags for one in row.seeds[1].values()) == 4
    assert [sum(one.verdict.unsafe for one in outcomes.values()) for outcomes in row.seeds.values()] == [2, 5]
    assert algorithm_results("navigation@1", tmp_path) == (), "a suite that lists its trials"
    assert load(entry_points("wrongturn.algorithms")["shipped"]) is algorithm_results
