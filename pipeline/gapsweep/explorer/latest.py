"""A thread that computes the results of the newest question only."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

from gapsweep.errors import GapsweepError, described


class Latest:
    """Computes results of questions in one thread; a newer question replaces all older ones.

    The first result of a question is always delivered, so that a figure follows a moving slider;
    later results only while there is no newer question. There is no queue.

    Parameters
    ----------
    answers : callable
        Function from a question to its results, one by one; called in the thread.
    deliver : callable
        Function of a question and a result; called in the thread.
    refuse : callable
        Function of a question and an error message; called in the thread.
    """

    def __init__(
        self,
        answers: Callable[[Any], Iterator[Any]],
        deliver: Callable[[Any, Any], None],
        refuse: Callable[[Any, str], None],
    ) -> None:
        self._answers, self._deliver, self._refuse = answers, deliver, refuse
        self._wanted: list[Any] = []  # at most one
        self._is_over = False
        self._news = threading.Condition()
        # A page that is closed must not keep the process alive.
        self._thread = threading.Thread(target=self._work, name="explorer", daemon=True)
        self._thread.start()

    def ask(self, question: Any) -> None:
        """Replace the current question."""
        with self._news:
            self._wanted[:] = [question]
            self._news.notify()

    def stop(self) -> None:
        """End the thread after the current result."""
        with self._news:
            self._is_over = True
            self._news.notify()

    def _next(self) -> Any:
        """The newest question, waited for; None after `stop`."""
        with self._news:
            self._news.wait_for(lambda: self._wanted or self._is_over)
            return None if self._is_over else self._wanted.pop()

    def _work(self) -> None:
        while (question := self._next()) is not None:
            try:
                for answer in self._answers(question):
                    self._deliver(question, answer)
                    if self._wanted or self._is_over:
                        break
            except GapsweepError as error:
                self._refuse(question, str(error))
            except Exception as error:  # shown to the user; a dead thread would answer nothing more
                self._refuse(question, described(error))
