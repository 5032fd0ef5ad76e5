import os
import signal

import pytest

from pipeline.interrupts import check_interrupted, interrupts_kept


class _Finalized:
    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)  # the exception is raised here, where Python ignores it


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_that_python_drops_is_not_lost() -> None:
    before = signal.getsignal(signal.SIGINT)
    with interrupts_kept():
        check_interrupted()
        _Finalized()
        with pytest.raises(KeyboardInterrupt):
            check_interrupted()
    assert signal.getsignal(signal.SIGINT) is before
    with interrupts_kept():
        check_interrupted()


def test_an_interrupt_is_raised_at_once() -> None:
    with interrupts_kept(), pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
        signal.pause()
