"""Errors that a user can act on."""


class UserError(Exception):
    """Bad input: one clear line says what, where, expected, got, and what to do.

    The command line prints the message without a traceback and exits with code 2.

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
        parts = [what if where is None else f"{where}: {what}"]
        if expected is not None:
            parts.append(f"expected {expected}")
        if got is not None:
            parts.append(f"got {got}")
        line = ", ".join(parts)
        if hint is not None:
            line = f"{line}; {hint}"
        # A value from a file may hold line breaks; the message stays one line all the same.
        super().__init__(" ".join(line.splitlines()))
