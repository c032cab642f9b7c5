"""What has to hold of agents, evaluations and episodes, told without any of the service's own code."""

from dataclasses import dataclass, field

from answers import Answer
from served_app import ABORT_S, RELEASE_S, SLOTS, STEPS, WAITING

Action = tuple[float, float, float]
TRIALS = 12
"""Of smoke@3, twins and all."""


@dataclass(eq=False)
class Agent:
    """Who calls; each is itself alone."""

    id: str
    token: str
    unused: str = ""
    """What the deleted evaluation had promised, whose secret the next one takes."""


@dataclass(eq=False)
class Evaluation:
    """One of an agent's."""

    id: str
    agent: Agent
    commitment: str
    driven: bool = False  # whether a step was asked for
    rest: int = 0  # trials that had no verdict when it was closed
    episodes: "list[Episode]" = field(default_factory=list)

    @property
    def open(self) -> int:
        """Episodes that are being driven."""
        return sum(episode.state == "open" for episode in self.episodes)

    @property
    def finished(self) -> int:
        """Trials that have their verdict."""
        return sum(episode.state == "finished" for episode in self.episodes) + self.rest

    @property
    def state(self) -> str:
        """As the service has to tell it."""
        return "finished" if self.finished == TRIALS else "running"

    def close(self) -> None:
        """What is missing counts as aborted. A second time changes nothing."""
        if self.state == "finished":
            return
        for episode in self.episodes:
            if episode.state == "open":
                episode.end("aborted")
        self.rest = TRIALS - self.finished


@dataclass(eq=False)
class Episode:
    """One drive."""

    id: str
    agent: Agent
    evaluation: Evaluation | None
    last: Answer  # to its reset or a step
    heard: float  # when its agent was heard of last, by the leases' clock
    actions: list[Action] = field(default_factory=list)
    state: str = "open"
    held: bool = True
    verdict: str | None = None

    @property
    def seq(self) -> int:
        """Of the last reply."""
        return len(self.actions)

    @property
    def shown(self) -> bool:
        """Whether its outcome may be told."""
        if self.state != "finished":
            return False
        return self.evaluation is None or self.evaluation.state == "finished"

    def refusal(self, agent: Agent) -> str | None:
        """What each call on it is refused with that needs it open, or to have been."""
        if agent is not self.agent:
            return "forbidden"
        if self.state == "lost":
            return "episode-lost"
        return None

    def step(self, agent: Agent, seq: int, action: Action) -> str:
        """What a step comes to where simulators are free: ``taken``, ``repeat``, or the type of a problem."""
        if seq < 1:
            return "validation"
        refusal = self.refusal(agent)
        if refusal is not None:
            return refusal
        if seq == self.seq:
            return "repeat" if action == self.actions[-1] else "action-mismatch"
        if self.state == "finished":
            return "episode-finished"
        if seq != self.seq + 1:
            return "sequence-gap"
        self.asked()
        return "taken"

    def asked(self) -> None:
        """Its next step was asked for, so that its evaluation counts."""
        if self.evaluation is not None:
            self.evaluation.driven = True

    def take(self, action: Action, answer: Answer) -> None:
        """It was stepped, and has to have told so."""
        self.asked()
        self.actions.append(action)
        self.last = answer
        over = self.seq == STEPS
        expected = {"seq": self.seq, "terminated": over, "truncated": False}
        if self.evaluation is None:
            expected["reward"] = 1.0
            if over:
                expected["verdict"] = "exit_commanded"
        assert (answer.status, answer.fields, answer.speed) == (200, expected, float(self.seq))
        self.held = True
        if over:
            self.end("exit_commanded")

    def end(self, verdict: str) -> None:
        """It has its verdict."""
        self.state, self.held, self.verdict = "finished", False, verdict

    def lose(self) -> None:
        """It came to nothing."""
        self.state, self.held = "lost", False


@dataclass
class World:
    """All that there is, and the leases' clock."""

    episodes: list[Episode] = field(default_factory=list)
    now: float = 0.0
    line: set[tuple[Agent, str]] = field(default_factory=set)
    """Who was told to come back for a simulator, and what for."""

    @property
    def open(self) -> list[Episode]:
        """Episodes that are being driven."""
        return [episode for episode in self.episodes if episode.state == "open"]

    @property
    def full(self) -> bool:
        """Whether every simulator is held."""
        return sum(episode.held for episode in self.episodes) == SLOTS

    def waits(self, agent: Agent, call: str, answer: Answer) -> bool:
        """Whether a call that needs another simulator had to wait for it; holds the answer against the line."""
        mine = {place for place in self.line if place[0] is agent}
        if answer.kind == "simulators-busy":
            assert self.full or self.line
            assert 1 <= answer.fields["position"] <= len(self.line | {(agent, call)})
            self.line.add((agent, call))
            return True
        if answer.kind == "rate-limited" and len(mine - {(agent, call)}) == WAITING:
            return True
        assert not self.full
        self.line.discard((agent, call))
        return False

    def silence(self, seconds: float) -> None:
        """So much time goes by in which nobody calls."""
        self.now += seconds
        # Places are kept for less than the shortest silence.
        self.line.clear()
        for episode in self.open:
            silent = self.now - episode.heard
            if silent >= ABORT_S:
                episode.end("aborted")
            elif silent >= RELEASE_S:
                episode.held = False

    def restart(self) -> None:
        """What was open is gone with the service."""
        self.line.clear()
        for episode in self.open:
            episode.lose()
