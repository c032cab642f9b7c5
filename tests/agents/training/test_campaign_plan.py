import pytest

from wrongturn_agents.training.campaign_plan import Job, Plan, default_plan, read_plan
from wrongturn_agents.training.errors import TrainingError


def test_a_seed_of_each_agent_comes_first():
    plan = default_plan()
    assert [job.name for job in plan.jobs[:3]] == ["ppo-image.s1", "ppo-auxiliary.s1", "ppo-segmentation.s1"]
    names = {job.name for job in plan.jobs}
    for algorithm in ("ppo-segmentation", "ppo-image", "ppo-auxiliary"):
        assert {f"{algorithm}.s{seed}" for seed in range(1, 6)} <= names
    assert {job.variant for job in plan.jobs} == {
        None,
        "masked-classes",
        "without-augmentation",
        "without-auxiliary-loss",
        "without-pretraining",
    }
    assert {job.slots for job in plan.jobs if job.algorithm == "ppo-auxiliary"} == {2}


def test_one_pretraining_for_all_seeds():
    jobs = {job.name: job for job in default_plan(share_encoder=True, scale=0.5).jobs}
    assert jobs["ppo-image.s1"].encoder_of is None
    assert jobs["ppo-image.s5"].encoder_of == "ppo-image.s1"
    assert jobs["ppo-image.without-augmentation.s1"].encoder_of is None
    assert jobs["ppo-segmentation.s3"].minutes == 1.75


def test_a_plan_of_ones_own(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(
        'suites = ["smoke@1"]\nslots = 2\n[[jobs]]\nalgorithm = "ppo-image"\nseed = 7\noptions = ["augment=false"]\n'
        '[[jobs]]\nalgorithm = "ppo-segmentation"\nsteps = 100\n'
    )
    plan = read_plan(path)
    assert (plan.suites, plan.slots) == (("smoke@1",), 2)
    assert [(job.name, job.minutes, job.steps) for job in plan.jobs] == [
        ("ppo-image.without-augmentation.s7", 5.0, None),
        ("ppo-segmentation.s1", None, 100),
    ]
    assert Job.of(plan.jobs[0].as_dict()) == plan.jobs[0]


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("", "jobs"),
        ("colour = 1", "colour"),
        ("[[jobs]]\nseed = 1", "algorithm"),
        ('[[jobs]]\nalgorithm = "dqn"', "algorithm"),
        ('[[jobs]]\nalgorithm = "ppo-image"\nsize = 3', "size"),
        ('[[jobs]]\nalgorithm = "ppo-image"\noptions = ["masked_classes=1"]', "masked_classes"),
        ('[[jobs]]\nalgorithm = "ppo-image"\nencoder_of = "x"', "encoder_of"),
        ("a = ", "cannot be read"),
    ],
)
def test_plans_that_cannot_be(tmp_path, text, field):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    with pytest.raises(TrainingError, match=field):
        read_plan(path)


def test_the_same_run_twice():
    with pytest.raises(TrainingError, match=r"ppo-image\.s1.*twice"):
        Plan(jobs=(Job(algorithm="ppo-image"), Job(algorithm="ppo-image")))
