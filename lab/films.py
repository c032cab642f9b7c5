"""How the shipped agents fail: drives their unsafe trials again, measures them, and films each way in which they end.

    python -m lab.films                    # the agents whose weights or results have changed
    python -m lab.films --agent ppo-image
    python -m lab.films --again            # new films of the same drives, after a change of how films look

What was seen is in ``lab/stored/studies/failures.json``; ``docs/failures.md`` shows it, and needs no driving.
"""

import argparse
import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from shapely import Point, Polygon

from lab.in_process import DrivenEpisode, drive_in_process
from lab.stored_results import Collection
from lab.studies import read, threads, weights_sha256, write
from lab.tables import OutdatedPageError, Row, Table, label_first
from wrongturn_agents.errors import AgentsError, ResultsError
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.registry import resolve
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_agents.stored_results import STORED
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND, installed_suite
from wrongturn_client.episode_calls import action_of
from wrongturn_networks import load_suite, town_of
from wrongturn_protocol import Command, Condition, FaultKind, JunctionType, Outcome, Task, Trial, Verdict, View, words
from wrongturn_protocol.episodes import twin_id
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import VEHICLE, Episode, JudgeGeometry, Replay, Trajectory
from wrongturn_sim import Row as Record
from wrongturn_sim.view.window import box

FILMS: Final = Path("docs/pictures/failures")
"""Directory of the films in the repository."""
_STUDY: Final = "failures"
_SIZE: Final = 280
"""Side of the view from above, pixels."""
_EVERY: Final = 2
"""Every second decision is a frame."""
_RATE: Final = 10 // _EVERY
"""Frames a second."""
_RUN_UP: Final = 25.0
"""Metres before the stop line at which a film begins."""
_LONGEST_S: Final = 12.0
"""Seconds of the longest film, which shows the end."""
_MOST: Final = 6
"""Films of an agent: its most frequent ways have one."""
_INSTEAD: Final = 2
"""Films of an agent without an unsafe trial: where others fail most."""
_TURNED: Final = 10.0
"""Degrees away from the lane at which a car has begun to turn. Starts are up to 6° askew."""
_NEAR: Final = 10.0
"""Metres before the stop line from which a turn counts."""
_EACH: Final = 2
"""Journeys of each condition that are driven."""
_PEDESTRIAN: Final = 0.5
"""Length of a pedestrian, m."""
_SIGHT: Final = 30.0
"""Distance within which a road user is large enough in the camera's picture, m."""
_HALF_VIEW: Final = math.degrees(math.atan2(96.0, 107.4))
"""Half of the camera's view, degrees."""
_BEFORE_S: Final = 2.0
"""Seconds before a collision whose pedals count."""
_ALONG: Final = 45.0
"""Greatest angle between two vehicles that drive in the same direction, degrees."""
_ROADS: Final = {
    JunctionType.LEFT_RIGHT: "left and right",
    JunctionType.STRAIGHT_LEFT: "straight on and left",
    JunctionType.STRAIGHT_RIGHT: "straight on and right",
    JunctionType.CROSS: "in all directions",
}
"""Where roads lead from a junction type's approach."""


class Way(NamedTuple):
    """One way in which trials end: those of one junction type and fault with the same ending and reaction."""

    junction_type: str
    fault: str
    ending: str
    """``exit``, or the verdict; the first flag, where flags alone make a trial unsafe in the strict column."""
    reaction: str | None

    @classmethod
    def of(cls, trial: Trial, result: TrialResult) -> "Way":
        """Return the way in which a trial ended."""
        flagged = result.unsafe_strict and not result.verdict.unsafe_strict
        ending = result.flags[0] if flagged else "exit" if result.verdict.exited else result.verdict
        return cls(
            str(trial.junction_type), str(trial.fault.kind), str(ending), result.reaction and str(result.reaction)
        )

    @property
    def cell(self) -> tuple[str, str]:
        """Junction type and fault."""
        return self.junction_type, self.fault

    def film(self, agent: str) -> str:
        """Return the name of an agent's film of this way."""
        words = ".".join(str(word or "none").lower().replace("_", "-") for word in self)
        return f"{agent}.{words}.webp"


class Ended(NamedTuple):
    """How an agent's trials ended, by its stored results."""

    secret: str
    ways: Mapping[Way, tuple[str, ...]]
    """Ids of the trials of each way, without twins, sorted."""
    unsafe: Mapping[Way, tuple[str, ...]]
    """Those that are unsafe in the strict column."""

    @classmethod
    def of(cls, agent: str, collection: Collection) -> "Ended":
        """Return how the shipped agent's trials ended over the service."""
        file = collection.of_shipped(WRONG_COMMAND, agent)
        if file is None or file.secret is None:
            raise ResultsError(f"{agent}: has no stored results on {WRONG_COMMAND}; import a run first")
        trials = file.drawn.trials
        found: dict[Way, list[str]] = {}
        for name, result in sorted(file.trials.items()):
            if not trials[name].is_twin:
                found.setdefault(Way.of(trials[name], result), []).append(name)
        ways = {way: tuple(found[way]) for way in sorted(found, key=str)}
        return cls(file.secret, ways, {way: of for way, of in ways.items() if file.trials[of[0]].unsafe_strict})


def learned_agents() -> tuple[str, ...]:
    """Return the names of the learned agents whose weights are shipped."""
    return (*(name for name, agent in SHIPPED_AGENTS.items() if agent.file.is_file()), *DOUBTING_AGENTS)


def outdated(known: Mapping[str, Any], agent: str, ended: Ended) -> str | None:
    """Return why an agent's films do not show it as it is; None if they do."""
    if known["weights_sha256"] != weights_sha256(agent):
        return "its weights have changed"
    trials = {_way(one): tuple(one["trials"]) for one in known["ways"]}
    found = ended.unsafe or {way: names for way, names in ended.ways.items() if way in trials}
    return None if (known["secret"], trials) == (ended.secret, found) else "its results have changed"


def _way(one: Mapping[str, Any]) -> Way:
    return Way(*(one[field] for field in Way._fields))


def _films(study: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of all films, by the names of their files."""
    shown = [one for agent in study.values() for one in (*agent["ways"], *(agent["journeys"] or ()))]
    return {one["film"]["file"]: one["film"]["sha256"] for one in shown if one["film"] is not None}


def check_films(collection: Collection) -> None:
    """Raise OutdatedPageError if a film is not of the stored results and the shipped weights."""
    study = read(_STUDY)
    remedy = "make them with 'python -m lab.films', and write docs/failures.md anew"
    for agent in (name for name in learned_agents() if collection.of_shipped(WRONG_COMMAND, name)):
        why = outdated(study[agent], agent, Ended.of(agent, collection)) if agent in study else "are missing"
        if why is not None:
            raise OutdatedPageError(f"films of {agent}: {why}; {remedy}")
    for file, sha256 in _films(study).items():
        path = FILMS / file
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            raise OutdatedPageError(f"{path}: is not the film that was made; {remedy}")
    extra = sorted(path.name for path in FILMS.glob("*.webp") if path.name not in _films(study))
    if extra:
        raise OutdatedPageError(f"{FILMS / extra[0]}: no page shows it; delete it")


def ways_table() -> Table:
    """Return a row for each way in which the agents' unsafe trials end, with medians and ranges, and the film."""
    rows: list[Row] = []
    study = read(_STUDY)
    for agent in (name for name in learned_agents() if name in study):
        each = []
        for one in study[agent]["ways"]:
            if not one["film"]:  # an agent without unsafe trials, where others seldom fail
                continue
            way, drives = _way(one), [drive["own"] for drive in one["drives"]]
            missing = JunctionType(way.junction_type).missing
            told = words.COMMANDS[missing if way.fault == FaultKind.INFEASIBLE and missing else Command.LANE_FOLLOW]
            film = f"[film](pictures/failures/{one['film']['file']})"
            twins = [drive["twin"] for drive in one["drives"]]
            each.append(
                (
                    told,
                    _ROADS[JunctionType(way.junction_type)],
                    ", ".join(dict.fromkeys(map(words.name, filter(None, (way.ending, way.reaction))))),
                    str(len(one["trials"])),
                    *(_spread(each_of["line_speed"] for each_of in group) for group in (drives, twins)),
                    *(_spread(each_of["turn_begins"] for each_of in group) for group in (drives, twins)),
                    film,
                )
            )
        rows += label_first(f"`{agent}`", each)
    head = ("agent", "told", "roads lead", "it ends", "trials of 10", "m/s at the line", "its twins", "turns at m past",
            "its twins", "")  # fmt: skip
    note = (
        "Medians with their range over the trials of a row, and over their twins. A turn begins where the car first "
        "points 10° away from its lane, in metres past the stop line. Agents without an unsafe trial are shown where "
        "others fail."
    )
    return Table("How the shipped agents fail", head, rows, note, words=4)


def collisions_table() -> Table:
    """Return how each agent's journeys beside traffic ended, and what it hit."""
    rows: list[Row] = []
    study = read(_STUDY)
    for agent in (name for name in learned_agents() if name in study):
        journeys = study[agent]["journeys"] or ()
        hits = [one for one in journeys if one["contact"] is not None]
        said = [
            f"{one['contact']['other']} at {one['contact']['speed']:.1f} m/s, in view for "
            f"{one['contact']['in_view_s']:.1f} s, brake {one['contact']['brake']:.2f}"
            + (f" ([film](pictures/failures/{one['film']['file']}))" if one["film"] else "")
            for one in hits
        ]
        if journeys:
            arrived = sum(one["verdict"] == Verdict.ARRIVED for one in journeys)
            rows.append((f"`{agent}`", f"{arrived} of {len(journeys)}", "; ".join(said) or "–"))
    return Table("Journeys beside traffic", ("agent", "arrived", "collisions"), rows, words=3)


def _spread(values: Iterable[float | None]) -> str:
    """Return a median with its range, ``4.3 (3.9–4.6)``; a dash if there is no value."""
    known = sorted(value for value in values if value is not None)
    if not known:
        return "–"
    low, middle, high = (f"{value:.1f}" for value in (known[0], median(known), known[-1]))
    return middle if low == high else f"{middle} ({low}{' to ' if known[0] < 0 else '–'}{high})"


def make(agents: Sequence[str]) -> None:
    """Drive, measure and film the agents that are outdated, and remove films that nothing shows any more."""
    study, collection = read(_STUDY), Collection.read(STORED)
    driven = (name for name in learned_agents() if collection.of_shipped(WRONG_COMMAND, name))
    everyone = {name: Ended.of(name, collection) for name in driven}
    cells = Counter(way.cell for ended in everyone.values() for way, names in ended.unsafe.items() for _ in names)
    for name in agents or everyone:
        if name in study and outdated(study[name], name, everyone[name]) is None:
            continue
        ways = film_ways(name, everyone[name], cells)
        journeys = film_journeys(name) if name in SHIPPED_AGENTS else []
        study[name] = {"weights_sha256": weights_sha256(name), "secret": everyone[name].secret, "ways": ways,
                       "journeys": journeys}  # fmt: skip
        write(_STUDY, study)
    for path in FILMS.glob("*.webp"):
        if path.name not in _films(study):
            path.unlink()


def film_again(agents: Sequence[str]) -> None:
    """Drive the trials of the agents' films again, and film them anew."""
    study, known = read(_STUDY), {trial.id: trial for trial in journeys()}
    for name in agents or study:
        suite = installed_suite(WRONG_COMMAND, study[name]["secret"])
        for one in (*study[name]["ways"], *study[name]["journeys"]):
            if one["film"] is None:
                continue
            trial = known.get(one["film"]["trial"]) or suite.trials[one["film"]["trial"]]
            driven = drive_trial(name, trial)
            if trial.journey is None and Way.of(trial, _result(driven)) != _way(one):
                raise ResultsError(f"{name}: {trial.id} ends otherwise than in {_STUDY}.json; leave out --again")
            first = _decision_before_line(driven.trajectory) if trial.journey is None else 0
            one["film"] = _film(name, driven, FILMS / one["film"]["file"], first)
            write(_STUDY, study)


def film_ways(name: str, ended: Ended, cells: Mapping[tuple[str, str], int], folder: Path = FILMS) -> list[Any]:
    """Drive an agent's unsafe trials and their twins again, and make a film of each way in which they end.

    Args:
        name: The agent.
        ended: How its trials ended.
        cells: Where other agents fail, and how often. An agent without an unsafe trial is filmed there.
        folder: Folder of the films.

    Raises:
        ResultsError: No trial of a way ends that way again.
    """
    ways = dict(ended.unsafe)
    often = sorted(ways, key=lambda way: -len(ways[way]))[:_MOST]
    if not ways:
        ways = {way: names for way, names in ended.ways.items() if way.cell in cells}
        often = sorted(ways, key=lambda way: -cells[way.cell])[:_INSTEAD]
    trials = installed_suite(WRONG_COMMAND, ended.secret).trials
    wanted = dict.fromkeys(one for names in ways.values() for name in names for one in (name, twin_id(trials[name])))
    with show_progress(ProgressStyle.AUTO, f"{name}, films") as progress:
        shown = [trials[one] for one in wanted]
        driven = {
            one.trial.id: one for one in drive_in_process(resolve(name), shown, threads=threads(), progress=progress)
        }
    found = []
    for way, names in ways.items():
        alike = [one for one in (driven[trial] for trial in names) if Way.of(one.trial, _result(one)) == way]
        if not alike:
            raise ResultsError(
                f"{name}: none of {', '.join(names)} ends in {way.ending} again; its results are of other weights, or "
                "of another machine: drive it over the service again and import the run"
            )
        drives = [
            {"trial": one.trial.id, "own": measure(one), "twin": measure(driven[twin_id(one.trial)])} for one in alike
        ]
        film = None
        if way in often:
            typical = min(alike, key=lambda one: (_oddness(one.trial.id, drives), one.trial.id))
            first = _decision_before_line(typical.trajectory)
            film = _film(name, typical, folder / way.film(name), first)
        found.append({**way._asdict(), "trials": names, "drives": drives, "film": film})
    return found


def _oddness(trial: str, drives: Sequence[Mapping[str, Any]]) -> float:
    """Return how far a drive is from the median one: metres and m/s count alike, and 10 degrees as one."""
    own = {one["trial"]: one["own"] for one in drives}
    far = 0.0
    for field, scale in (("line_speed", 1.0), ("past_middle", 1.0), ("left", 1.0), ("turned", 0.1)):
        known = [one[field] for one in own.values() if one[field] is not None]
        if known and own[trial][field] is not None:
            far += scale * abs(own[trial][field] - median(known))
    return far


def _film(name: str, driven: DrivenEpisode, file: Path, first: int = 0) -> dict[str, str]:
    replay = Replay(driven.trajectory, driven.outcome, name)
    first = max(first, len(replay) - round(10 * _LONGEST_S))
    from wrongturn_sim.view.film import write_film  # PyAV takes a quarter of a second

    write_film(file, replay.frames(View.BOTH, _SIZE, first=first, every=_EVERY), rate=_RATE, small=True)
    return {"file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest(), "trial": driven.trial.id}


def _result(driven: DrivenEpisode) -> TrialResult:
    return TrialResult.of(_outcome(driven))


def _outcome(driven: DrivenEpisode) -> Outcome:
    assert driven.outcome is not None  # each drive ends with its verdict
    return driven.outcome


def _geometry(trajectory: Trajectory) -> JudgeGeometry:
    return JudgeGeometry.of(town_of(trajectory.trial), trajectory.trial)


def measure(driven: DrivenEpisode) -> dict[str, float | None]:
    """Return what a trajectory shows, beside the lane that leads to the stop line, extended straight.

    Speeds in m/s, lengths in m, angles in degrees, positive to the left; past the stop line, from the nose on, None if
    it never was: ``line_speed``, ``slowest``, most steering to each side (0 to 1), and ``beyond_grip_s``, in which the
    wheels asked for a tighter curve than the grip allows. ``turn_begins`` is where the centre first pointed 10° away
    from the lane. At the end: ``turned``, ``past_middle`` of the junction, ``left`` of the lane's axis, speed, brake.
    """
    geometry, rows = _geometry(driven.trajectory), driven.trajectory.rows
    *_, ux, uy = geometry.stop_line
    heading = math.atan2(uy, ux)
    places = [
        (*geometry.beside_approach(row.x, row.y), math.degrees(math.remainder(row.yaw - heading, math.tau)))
        for row in rows
    ]
    inside = [row for row, (past, *_) in zip(rows, places, strict=True) if past + VEHICLE.half_length >= 0.0]
    middle, _ = geometry.beside_approach(*geometry.middle)
    past, left, turned = places[-1]
    wide = sum(map(_runs_wide, inside)) * (rows[1].t - rows[0].t) if inside else None
    found: dict[str, float | None] = {
        "line_speed": inside[0].v if inside else None,
        "slowest": min((row.v for row in inside), default=None),
        "steer_left": max((max(-row.steering, 0.0) for row in inside), default=None),
        "steer_right": max((max(row.steering, 0.0) for row in inside), default=None),
        "beyond_grip_s": wide,
        "turn_begins": next((way for way, _, angle in places if way > -_NEAR and abs(angle) >= _TURNED), None),
        "turned": turned,
        "past_middle": past - middle,
        "left": left,
        "end_speed": rows[-1].v,
        "end_brake": rows[-1].brake,
        "opposed_m": _outcome(driven).opposed_lane_m or 0.0,
    }
    return {name: None if value is None else round(value, 2) for name, value in found.items()}


def _decision_before_line(trajectory: Trajectory) -> int:
    """Return the last decision at which the nose was :data:`_RUN_UP` before the stop line; 0 if none was."""
    geometry = _geometry(trajectory)
    noses = [geometry.beside_approach(row.x, row.y)[0] + VEHICLE.half_length for row in trajectory.rows[::2]]
    return max(next((number for number, past in enumerate(noses) if past > -_RUN_UP), len(noses)) - 1, 0)


def _runs_wide(row: Record) -> bool:
    """Return whether the wheels ask for a tighter curve than the grip allows."""
    curvature = math.tan(abs(row.steering) * VEHICLE.max_wheel_angle) / VEHICLE.wheelbase
    return curvature * row.v**2 > VEHICLE.grip


def journeys() -> list[Trial]:
    """Return the journeys that are driven: the first ones of each condition, beside traffic."""
    found: dict[Condition, list[Trial]] = {condition: [] for condition in Condition}
    for trial in load_suite(NAVIGATION).episodes:
        if trial.journey is not None and trial.journey.task is Task.NAVIGATION_DYNAMIC:
            found[Condition.of(trial.town, trial.weather)].append(trial)
    return [trial for own in found.values() for trial in own[:_EACH]]


def film_journeys(name: str, trials: Sequence[Trial] = (), folder: Path = FILMS) -> list[Any]:
    """Drive journeys beside SUMO's traffic, and make a film of the most frequent kind of collision."""
    driven: list[DrivenEpisode] = []
    found: list[dict[str, Any]] = []
    trials = trials or journeys()
    with show_progress(ProgressStyle.AUTO, f"{name}, beside traffic") as progress:
        for number, trial in enumerate(trials):
            progress(number, len(trials))
            driven.append(drive_trial(name, trial))
    for one in driven:
        verdict, condition = _outcome(one).verdict, Condition.of(one.trial.town, one.trial.weather)
        contact = contact_of(one.trajectory) if verdict is Verdict.COLLISION else None
        found.append({"trial": one.trial.id, "condition": str(condition), "verdict": str(verdict), "contact": contact,
                      "film": None})  # fmt: skip
    for kind, _ in Counter(one["contact"]["other"] for one in found if one["contact"]).most_common(1):
        number = next(k for k, one in enumerate(found) if one["contact"] and one["contact"]["other"] == kind)
        found[number]["film"] = _film(name, driven[number], folder / f"{name}.traffic.webp")
    return found


def drive_trial(name: str, trial: Trial) -> DrivenEpisode:
    """Return how an agent drives a trial, in SUMO where there are other road users."""
    source = resolve(name)
    agent, episode = source.make(), Episode(trial, source.sight)
    observation = episode.reset()
    agent.reset(observation_space(source.sight))
    while episode.outcome is None:
        action = action_of(agent.act(observation))
        observation = episode.step(action.steer, action.throttle, action.brake).observation
    return DrivenEpisode(trial, episode.trajectory, episode.outcome)


def contact_of(trajectory: Trajectory) -> dict[str, Any]:
    """Return what a trajectory that ended in a collision shows of it and of the seconds before."""
    rows, end = trajectory.rows, trajectory.rows[-1]
    town = town_of(trajectory.trial)
    late = [row for row in rows if row.t > end.t - _BEFORE_S]
    car = Polygon(box(end.x, end.y, end.yaw, VEHICLE.length, VEHICLE.width))
    gaps = [car.distance(Polygon(box(*user[:5]))) for user in end.road_users]
    touched = min(range(len(gaps)), key=gaps.__getitem__, default=None)
    touched = touched if touched is not None and gaps[touched] < 0.1 else None
    return {
        "other": "scenery" if touched is None else _placed(end, end.road_users[touched]),
        "in_junction": any(junction.area.contains(Point(end.x, end.y)) for junction in town.junctions.values()),
        "speed": round(end.v, 2),
        "other_speed": 0.0 if touched is None else round(end.road_users[touched][5], 2),
        "in_view_s": 0.0 if touched is None else _in_view_s(trajectory, trajectory.road_user_numbers[-1][touched]),
        "brake": round(sum(row.brake for row in late) / len(late), 2),
        "throttle": round(sum(row.throttle for row in late) / len(late), 2),
    }


def _placed(row: Record, user: Sequence[float]) -> str:
    """Return how a road user was placed that the car touches."""
    if user[3] <= _PEDESTRIAN:
        return "pedestrian"
    angle = abs(math.degrees(math.remainder(user[2] - row.yaw, math.tau)))
    if angle > _ALONG:
        return "oncoming" if angle > 180.0 - _ALONG else "crossing"
    return "ahead" if abs(_bearing(row, user)) < 90.0 else "behind"


def _bearing(row: Record, user: Sequence[float]) -> float:
    """Return the direction in which the car sees a road user, degrees from straight ahead."""
    return math.degrees(math.remainder(math.atan2(user[1] - row.y, user[0] - row.x) - row.yaw, math.tau))


def _in_view_s(trajectory: Trajectory, number: int) -> float:
    """Return how long a road user has been in view without a break, seconds."""
    rows = trajectory.rows
    since = rows[-1].t
    for row, numbers in zip(reversed(rows), reversed(trajectory.road_user_numbers), strict=True):
        if number not in numbers:
            break
        user = row.road_users[numbers.index(number)]
        near = math.hypot(user[0] - row.x, user[1] - row.y) <= _SIGHT
        # A body that touches the car's side is no longer in view; it was when it came.
        if not near or (abs(_bearing(row, user)) > _HALF_VIEW and rows[-1].t - row.t > 1.0):
            break
        since = row.t
    return round(rows[-1].t - since, 2)


def main() -> None:
    """Run the program; an error is one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agent", action="append", default=[], choices=learned_agents())
    parser.add_argument("--again", action="store_true", help="new films of the same drives")
    options = parser.parse_args()
    try:
        (film_again if options.again else make)(options.agent)
    except (AgentsError, OSError) as error:
        raise SystemExit(f"lab.films: {error}") from error


if __name__ == "__main__":
    main()
