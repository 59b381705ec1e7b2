"""What goes to a terminal: text without the characters that would steer it, and one way to be stopped."""

import signal
import threading
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager


def plain(text: str) -> str:
    """Text that a terminal only shows: control and direction characters, which names in files may hold, as ``?``."""
    return "".join(c if c in "\n\t" or unicodedata.category(c) not in ("Cc", "Cf", "Cs") else "?" for c in text)


#: set by a signal that ends the work; whoever keeps an error as a result asks whether it came of that
stopped = threading.Event()


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Inside, SIGTERM is KeyboardInterrupt as Ctrl-C is: whatever keeps its work for the one keeps it for the other. So
    is every error after either: a compiler that is interrupted fails in its own way.

    In the main thread only, where Python handles signals; elsewhere this does nothing.
    """

    def stop(number: int, frame: object) -> None:
        stopped.set()
        raise KeyboardInterrupt

    before = {}
    try:
        for number in (signal.SIGTERM, signal.SIGINT):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as in a shell's background job
                before[number] = signal.signal(number, stop)
    except ValueError:  # not the main thread
        yield
        return
    try:
        yield
    except Exception as error:
        if stopped.is_set():
            raise KeyboardInterrupt from error
        raise
    finally:
        stopped.clear()
        for number, handler in before.items():
            signal.signal(number, handler)
