"""What a simulator process has compiled before it says that it is ready."""

import subprocess
import sys

PROGRAM = """
from wrongturn_service.simulators.worker import Server
from wrongturn_judge import decide, journey_kernels
compiled = [decide.observe, journey_kernels.observe]
assert not any(function.signatures for function in compiled)
Server().warm_up()
print([len(function.signatures) for function in compiled])
"""


def test_both_judges_are_compiled_before_the_first_agent_comes() -> None:
    ran = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=240)
    assert ran.stdout.split("\n")[-2] == "[1, 1]"
