"""Rules about episodes: practised, stepped in every order, looked at, aborted, and simulators that die meanwhile."""

import uuid

from answers import Way
from hypothesis import strategies as st
from hypothesis.stateful import precondition, rule
from life_model import Action
from living import ACTIONS, PRACTISED, WAYS, Living
from served_app import PRACTICE, STEPS


class EpisodeRules(Living):
    """Each holds one call on an episode against the model, or several at once."""

    @rule(data=st.data(), way=WAYS, keyed=st.booleans())
    def practise(self, data: st.DataObject, way: Way, keyed: bool) -> None:
        agent = self.an_agent(data)
        key = uuid.uuid4().hex if keyed else None
        call = ("practise", PRACTISED, key)
        answer = self.call(agent, way, *call)
        if self.practised(agent) == PRACTICE:
            assert answer.kind == "rate-limited"
        elif not self.world.waits(agent, f"practice {key}", answer):
            self.began(answer, agent, None)
            if keyed:
                self.keys.append((agent, way, call, answer))

    @rule(data=st.data(), way=WAYS, track=st.sampled_from(["camera", "state"]))
    def practise_in_another_track(self, data: st.DataObject, way: Way, track: str) -> None:
        answer = self.call(self.an_agent(data), way, "practise", {**PRACTISED, "track": track}, None)
        assert answer.kind == "track-not-available"

    @precondition(lambda self: self.world.open)
    @rule(data=st.data(), way=WAYS, action=ACTIONS)
    def step(self, data: st.DataObject, way: Way, action: Action) -> None:
        episode = data.draw(st.sampled_from(self.world.open))
        self.steps(episode, episode.agent, way, episode.seq + 1, action)

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS, ahead=st.integers(-3, 3), action=ACTIONS, same=st.booleans())
    def any_step(self, data: st.DataObject, way: Way, ahead: int, action: Action, same: bool) -> None:
        """Right, repeated, old or ahead; one's own or another's; open or over."""
        episode, agent = self.an_episode(data), self.an_agent(data)
        if same and episode.actions:
            action = episode.actions[-1]
        self.steps(episode, agent, way, episode.seq + ahead, action)

    @precondition(lambda self: self.world.open)
    @rule(data=st.data(), ways=st.tuples(WAYS, WAYS), action=ACTIONS)
    def the_same_step_twice_at_once(self, data: st.DataObject, ways: tuple[Way, Way], action: Action) -> None:
        episode = data.draw(st.sampled_from(self.world.open))
        if not episode.held and (self.world.full or self.world.line):
            return
        call = ("step", episode.id, episode.seq + 1, *action)
        if ways == (Way.SOCKET, Way.SOCKET):
            one, other = self.served.wait(self.answers.batch(episode.agent.token, [call, call]))
        else:
            one, other = self.at_once(*(self.answers.call(episode.agent.token, way, *call) for way in ways))
        episode.heard = self.world.now
        episode.take(action, one)
        assert other == one

    @precondition(lambda self: self.world.open)
    @rule(data=st.data(), count=st.integers(2, STEPS))
    def steps_in_one_message(self, data: st.DataObject, count: int) -> None:
        self.steps_ahead(data.draw(st.sampled_from(self.world.open)), count)

    @precondition(lambda self: self.world.open)
    @rule(data=st.data(), way=WAYS, action=ACTIONS, deaths=st.integers(1, 4), resets=st.integers(0, 2))
    def step_while_simulators_die(
        self, data: st.DataObject, way: Way, action: Action, deaths: int, resets: int
    ) -> None:
        """Up to three may die of a call unnoticed, and then the one that the episode had."""
        episode = data.draw(st.sampled_from(self.world.open))
        if not episode.held and (self.world.full or self.world.line):
            return
        pool = self.served.pool
        pool.deaths_at_step += [None] * deaths
        pool.deaths_at_reset += [None] * resets
        survived = deaths + resets - episode.held < 3
        answer = self.call(episode.agent, way, "step", episode.id, episode.seq + 1, *action)
        pool.deaths_at_step.clear()
        pool.deaths_at_reset.clear()
        episode.heard = self.world.now
        if survived:
            episode.take(action, answer)
        else:
            episode.asked()
            episode.lose()
            assert answer.kind == "episode-lost"

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS, kind=st.sampled_from(["deaths_at_start", "deaths_at_reset"]))
    def no_simulator_works(self, data: st.DataObject, way: Way, kind: str) -> None:
        """What is begun meanwhile is refused, and counts nowhere."""
        agent = self.an_agent(data)
        if self.world.full or self.world.line or self.practised(agent) == PRACTICE:
            return
        failures = getattr(self.served.pool, kind)
        failures += [None] * 3
        assert self.call(agent, way, "practise", PRACTISED, None).kind == "simulator-failed"
        assert not failures

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS)
    def look(self, data: st.DataObject, way: Way) -> None:
        episode, agent = self.an_episode(data), self.an_agent(data)
        answer = self.call(agent, way, "look", episode.id)
        public = way is not Way.SOCKET and episode.shown and episode.evaluation is not None
        if agent is not episode.agent and not public:
            assert answer.kind == "forbidden"
            return
        told = answer.fields
        assert (answer.status, told["state"]) == (200, episode.state)
        outcome = told["outcome"]
        assert (None if outcome is None else outcome["verdict"]) == (episode.verdict if episode.shown else None)
        if episode.state != "lost":
            assert told["seq"] == episode.seq
        if episode.state == "open":
            episode.heard = self.world.now
            assert (told["last_reply"], answer.speed) == (episode.last.fields, episode.last.speed)
        if episode.shown:
            # An abort without any simulator has none.
            assert told["actions_sha256"] == episode.sha256 or (
                told["actions_sha256"] is None and episode.verdict == "aborted"
            )

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data(), way=WAYS, deaths=st.integers(0, 4))
    def abort(self, data: st.DataObject, way: Way, deaths: int) -> None:
        """Whatever becomes of simulators meanwhile."""
        episode, agent = self.an_episode(data), self.an_agent(data)
        pool = self.served.pool
        pool.deaths_at_abort += [None] * deaths
        answer = self.call(agent, way, "abort", episode.id)
        pool.deaths_at_abort.clear()
        refusal = episode.refusal(agent)
        if refusal is None and episode.state == "finished" and episode.verdict != "aborted":
            refusal = "episode-finished"
        if agent is episode.agent:
            episode.heard = self.world.now
        if refusal is None and episode.state == "open":
            if not episode.held and self.world.waits(agent, episode.id, answer):
                return
            episode.end("aborted")
        assert answer.kind == (refusal or "")

    @precondition(lambda self: self.world.episodes)
    @rule(data=st.data())
    def trajectory(self, data: st.DataObject) -> None:
        episode, agent = self.an_episode(data), self.an_agent(data)
        answer = self.http(agent, "GET", "/v1/episodes/{episode}/trajectory", episode=episode.id)
        public = episode.shown and episode.evaluation is not None
        if agent is not episode.agent and not public:
            assert answer.kind == "forbidden"
        elif episode.state == "lost":
            assert answer.kind == "episode-lost"
        elif episode.shown and answer.status == 200:
            assert answer.fields == {"steps": episode.seq}
        else:
            # An abort without any simulator left none.
            assert answer.kind == "episode-not-shown"
            assert not episode.shown or episode.verdict == "aborted"
