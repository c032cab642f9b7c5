"""The program ``python -m wrongturn_runner``: checks or drives one submission, as :mod:`.messages` says."""

import sys

from wrongturn_client import WrongturnError
from wrongturn_runner.conversation import FAILED, Conversation, ModelAtFaultError, NoRoomError, RunnerFailedError
from wrongturn_runner.jobs import check, drive
from wrongturn_runner.messages import BUSY, JOB, REASON_MOST, CheckJob, Refused
from wrongturn_sandbox.reasons import printable


def main() -> int:
    """Do one job and return the exit status."""
    conversation = Conversation()
    try:
        job = conversation.read(JOB)
        conversation.tell(check(job, conversation) if isinstance(job, CheckJob) else drive(job, conversation))
    except ModelAtFaultError as error:
        conversation.tell(Refused(reason=printable(str(error), REASON_MOST)))
    except (RunnerFailedError, WrongturnError) as error:
        sys.stderr.write(f"wrongturn_runner: {printable(str(error), REASON_MOST)}\n")
        return BUSY if isinstance(error, NoRoomError) else FAILED
    return 0


if __name__ == "__main__":
    sys.exit(main())
