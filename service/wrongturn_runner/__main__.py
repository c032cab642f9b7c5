"""The program ``python -m wrongturn_runner``: checks or drives one submission, as :mod:`.messages` says."""

import sys

from wrongturn_client import WrongturnError
from wrongturn_runner.conversation import FAILED, Conversation
from wrongturn_runner.errors import ModelAtFaultError, NoRoomError, RunnerFailedError, plain
from wrongturn_runner.jobs import check, drive
from wrongturn_runner.messages import BUSY, CheckJob, Refused


def main() -> int:
    """Do one job and return the exit status."""
    conversation = Conversation()
    try:
        job = conversation.job()
        conversation.finish(check(job, conversation) if isinstance(job, CheckJob) else drive(job, conversation))
    except ModelAtFaultError as error:
        conversation.finish(Refused(reason=plain(str(error))))
    except NoRoomError as error:
        sys.stderr.write(f"wrongturn_runner: {plain(str(error))}\n")
        return BUSY
    except (RunnerFailedError, WrongturnError) as error:
        sys.stderr.write(f"wrongturn_runner: {plain(str(error))}\n")
        return FAILED
    return 0


if __name__ == "__main__":
    sys.exit(main())
