"""Commands as sentences: each phrasing names its own command and no other, so the judge can go by the command."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_faults import OPENPILOT, RULES, Command, Guidance, Order, Passage, one_hot, phrasings, sentence
from wrongturn_faults.sentences import KINDS

L, R, S, F, V = Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW, Command.VOID
WORDS = {L: r"\bleft\b", R: r"\bright\b", S: r"\bstraight\b"}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", [L, R, S, F])
def test_a_phrasing_names_its_own_direction_and_no_other(command: Command, kind: str):
    texts = phrasings(command, kind)
    assert texts or kind == "ambiguous" or (kind, command) == ("ordinal", F)
    assert len({*texts}) == len(texts)
    for text in texts:
        named = {one for one, word in WORDS.items() if re.search(word, text, re.I)}
        assert named == ({command} if command in WORDS else set())
        assert ("{distance}" in text) == (kind == "distance")
        assert ("{ordinal}" in text) == (kind == "ordinal")


def test_left_and_right_are_said_alike():
    for kind in KINDS:
        assert [text.lower().replace("left", "right") for text in phrasings(L, kind)] == [
            text.lower() for text in phrasings(R, kind)
        ]


def test_silence_and_ambiguous_sentences_name_no_direction():
    assert sentence(V) == ""
    said = {sentence(V, "ambiguous", number=number) for number in range(9)}
    assert len(said) == 5
    assert not any(re.search(word, text, re.I) for text in said for word in WORDS.values())


@given(
    st.sampled_from([L, R, S, F]), st.sampled_from(KINDS), st.integers(0, 99), st.floats(0, 9_999), st.integers(1, 5)
)
def test_every_sentence_is_whole(command: Command, kind: str, number: int, distance: float, ordinal: int):
    text = sentence(command, kind, number=number, distance=distance, ordinal=ordinal)
    assert "{" not in text
    if text:
        assert text[0].isupper()
        assert text.endswith(".")
    if kind == "distance":
        assert str(round(distance)) in text


def test_the_sentence_of_a_fault_is_wrong_where_the_command_is():
    exits = frozenset({L, S})
    here = Passage(S, exits, 10.0, 26.0, first=True)
    told = RULES["infeasible"](0.0, Guidance(S, 10.0, ahead=here), Order(route=S, exits=exits, seed=7, dose=0.0))
    assert sentence(told, "distance", distance=10.0) == "Turn right in 10 m."


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"kind": "loud"}, "kind: there is no 'loud'; give one of plain"),
        ({"number": -1}, "number: is -1"),
        ({"kind": "distance"}, "distance: is None; give metres"),
        ({"kind": "distance", "distance": float("nan")}, "distance: is nan"),
        ({"ordinal": 6}, "ordinal: is 6; give 1 to 5"),
    ],
)
def test_a_wrong_argument_is_named(arguments: dict[str, object], named: str):
    with pytest.raises(ValueError, match=re.escape(named)):
        sentence(L, **arguments)


def test_openpilots_desires():
    assert one_hot(L, OPENPILOT, length=8) == [0, 1, 0, 0, 0, 0, 0, 0]
    assert [one_hot(one, OPENPILOT, length=8).index(1.0) for one in (R, S, F, V)] == [2, 0, 0, 0]
