"""Errors that a user can act on."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

_T = TypeVar("_T")
_SPEAKS_OF_FLAGS: ContextVar[bool] = ContextVar("errors speak of flags", default=False)
# A command in quotes stays as it is typed.
_FLAG = re.compile(r"'geraf2 [^']*'|(?<![\w-])--([a-z][a-z0-9.-]*)")


@contextmanager
def speaking_of_flags() -> Iterator[None]:
    """Name settings in errors as the command line does, `--n-samples`; else `n_samples`."""
    before = _SPEAKS_OF_FLAGS.set(True)
    try:
        yield
    finally:
        _SPEAKS_OF_FLAGS.reset(before)


def _without_dashes(found: re.Match[str]) -> str:
    return found[1].replace("-", "_") if found[1] else found[0]


class UserError(Exception):
    """Bad input: one clear line states what, where, expected, got, and what to do.

    The command line prints the message without a traceback and exits with code 2.

    Examples
    --------
    >>> try:
    ...     geraf2.load_prior((0.22, 0.22))
    ... except geraf2.UserError as error:
    ...     print(error)
    a box must have three positive side lengths [m], got 0.22 0.22
    """

    def __init__(
        self,
        what: str,
        *,
        where: object = None,
        expected: object = None,
        got: object = None,
        hint: str | None = None,
    ) -> None:
        # Names and values of a file may have any length.
        what = shortened(what, 400)
        parts = [what if where is None else f"{shortened(str(where), 300)}: {what}"]
        if expected is not None:
            parts.append(f"expected {shortened(str(expected), 300)}")
        if got is not None:
            parts.append(f"got {shortened(str(got), 250)}")
        line = ", ".join(parts)
        if hint is not None:
            line = f"{line}; {hint}"
        # A value from a file may hold line breaks; the message stays one line all the same.
        super().__init__(" ".join(line.splitlines()))

    def __str__(self) -> str:
        line = super().__str__()
        return line if _SPEAKS_OF_FLAGS.get() else _FLAG.sub(_without_dashes, line)


def shortened(text: str, most: int = 600) -> str:
    """Text of at most so many characters, without its middle: its end often states what to do."""
    if len(text) <= most:
        return text
    end = most // 3
    return f"{text[: most - end - 5]} ... {text[-end:]}"


def printable(text: str) -> str:
    """One line whose control characters are written as escapes.

    Names and values come from files; what would move the cursor, colour or hide text, or feign a
    line of its own, does not reach the terminal.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def attempt(function: Callable[[], _T]) -> tuple[_T | None, UserError | None]:
    """Return the result of a function and None, or None and its UserError.

    >>> from geraf2.errors import attempt
    >>> attempt(lambda: 1)
    (1, None)
    """
    try:
        return function(), None
    except UserError as error:
        return None, error


def lacks_memory(error: BaseException) -> bool:
    """Whether memory ran out, also as torch states it, and NumPy without an error of its own."""
    return isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError | SystemError)
        and any(text in str(error) for text in ("can't allocate memory", "without exception set"))
    )
