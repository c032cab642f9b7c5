"""Mistakes at the command line: one line that names the field and the remedy, and the status of a wrong usage."""

import re
import sys
from pathlib import Path

import pytest

from wrongturn_client import LocalService
from wrongturn_client.cli import main

MISTAKES: list[tuple[str, int, str]] = [
    ("run", 2, "AGENT: name one"),
    ("run nobody", 1, "there is no agent called 'nobody'; known are parked"),
    ("run careful --suite smoke@9", 1, "Did you mean smoke@3"),
    ("run careful --url http://127.0.0.1:9", 1, "start one by 'wrongturn serve'"),
    ("run no.onnx", 1, "no.onnx: there is no such file; name an .onnx file"),
    ("run careful --json /nowhere/x.json", 2, "--json: /nowhere/x.json cannot be written; name a file"),
    ("leaderboard smoke@3 --csv --json", 2, "--csv: .* leave out --json"),
    ("submit", 2, "FILE: name the model"),
    ("submit bad.onnx --url SERVICE", 2, "FILE: bad.onnx: the file is no ONNX model"),
    ("replay ep_no --picture a.png --url SERVICE", 1, "needs a token; set WRONGTURN_TOKEN"),
    ("trials ./no.json", 1, "./no.json: there is no such file or folder; correct its path"),
    ("whatif ep_no", 2, "--command, --at: give both, such as --command LEFT --at 3.2; or --sweep"),
    ("whatif bad.json --command LEFTT --at 3", 2, "--command: 'LEFTT' is not one of 'VOID', 'LEFT'"),
    ("dose careful --fault omission", 2, "--fault: 'omission' is no fault with a dose; take one of early"),
    ("train ppo-image --seeds 5-1", 2, "--seeds: '5-1' runs backwards; give the smaller seed first"),
    ("train ppo-image --option town=5", 2, "--option: 'town=5': give name=value .* Did you mean towns"),
    ("towns check no", 2, "FOLDER: no is no folder; name the one"),
    ("suites make --town Town01 --name a@1 --cells late=x", 2, "--cells: 'late=x' is no cell; write FAULT"),
    ("serve --port 99999", 2, "--port: is 99999; give a whole number from 0 to 65535"),
    ("openenv --track sonar", 2, "--track: 'sonar' is unknown; give one of camera"),
]


@pytest.mark.parametrize(("command", "status", "says"), MISTAKES)
def test_it_names_the_field_and_the_remedy(
    service: LocalService,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    command,
    status,
    says,
):
    monkeypatch.chdir(tmp_path)
    for name in ("bad.onnx", "bad.json"):
        Path(name).write_text('{"a": 1}')
    for name in ("WRONGTURN_URL", "WRONGTURN_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    words = [service.url if word == "SERVICE" else word for word in command.split()]
    monkeypatch.setattr(sys, "argv", ["wrongturn", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    told = capsys.readouterr().err
    assert told.count("\n") == 1, told
    assert re.search(says, told), told
    assert ended.value.code == status, told
