"""Entry point: finds the subcommand, turns errors into one line and an exit code."""

import errno
import importlib
import json
import logging
import math
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from inspect import cleandoc
from types import FrameType
from typing import Any, Protocol, cast

from geraf2._memory import memory_limit
from geraf2.cli._commands import (
    COMMANDS,
    ESTIMATED,
    GLOBAL_FLAGS,
    Command,
    memory_bytes,
    take_values,
    thread_count,
)
from geraf2.errors import UserError, lacks_memory, printable, shortened, speaking_of_flags

EXIT_OK = 0
EXIT_BUG = 1
EXIT_BAD_INPUT = 2
EXIT_SIGNAL = 128
"""Exit code of a signal less its number, as in shells: 130 after Ctrl-C, 143 after SIGTERM."""


class _CommandModule(Protocol):
    Config: type[Any]

    def main(self, config: Any) -> int: ...


# Signals that came, by number.
_received: list[int] = []


def run() -> None:
    """Run the command line of this process and exit with its code."""
    stop = _stopper()
    for number in (signal.SIGINT, signal.SIGTERM):  # a stopped batch job cleans up as Ctrl-C does
        if signal.getsignal(number) != signal.SIG_IGN:  # as jobs in the background of a script
            signal.signal(number, stop)
    signal.signal(signal.SIGALRM, _raise_again)
    sys.unraisablehook = _report_unraisable
    # After a signal, tasks of a store are abandoned, and asyncio would report their errors.
    logging.getLogger("asyncio").addFilter(lambda _: not _received)
    for stream in (sys.stdout, sys.stderr):  # what the locale cannot write is escaped
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    sys.exit(main(sys.argv[1:]))


def _stopper() -> Callable[[int, FrameType | None], None]:
    """Make a handler of signals that raises KeyboardInterrupt with the signal's number."""
    # A second signal within a second, as `timeout` and process groups send it, does not disturb the
    # cleaning up; a later one stops that, too.
    last = -1.0

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        if last < 0 or now > last + 1.0:
            last = now
            _received.append(number)
            _raise_again(number, frame)

    return stop


def _raise_again(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt for the last signal; after an import, which may swallow it."""
    if not _received:
        return
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    if frame is None:
        raise KeyboardInterrupt(_received[-1])
    signal.setitimer(signal.ITIMER_REAL, 0.01)


def _report_unraisable(args: "sys.UnraisableHookArgs") -> None:
    """Report an error in a destructor; suppress errors of half-finished objects after a signal."""
    # A destructor swallows what the signal's handler raises, so that comes again.
    if not _received:
        sys.__unraisablehook__(args)
    elif isinstance(args.exc_value, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, 0.01)


def main(arguments: Sequence[str]) -> int:
    """Run one command line; returns the exit code."""
    # Small matrix products, by the thousand, on BLAS threads that spin while they wait: on two
    # busy cores the glints of a capture took 45 s instead of 4. The kernels have threads of their
    # own. Only works before NumPy is loaded, which the commands do.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Threads that wait for work sleep: where other programs use the cores too, those that spin
    # keep the ones they wait for from running, and short kernels took seven times as long.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ["MPLBACKEND"] = "agg"  # pictures are files; matplotlib fails where it names none
    debug = "--debug" in arguments
    with speaking_of_flags():
        return _main(arguments, debug=debug)


def _main(arguments: Sequence[str], *, debug: bool) -> int:
    rest = [argument for argument in arguments if argument not in GLOBAL_FLAGS]
    logging.captureWarnings(capture=not debug)
    n_before = _n_written()
    try:
        if "--version" in arguments:
            from geraf2 import __version__  # noqa: PLC0415 - its search takes 40 ms

            print(f"geraf2 {__version__}")
            return EXIT_OK
        _require_environment()
        rest, values = take_values(rest)
        allowed = memory_bytes(values.get("--max-memory"))
        name = _command_of(rest)
        if allowed < math.inf and name is not None and name not in ESTIMATED:
            raise UserError(
                what=f"{name} has no estimate of its memory, which --max-memory would limit",
                expected=f"--max-memory with {', '.join(ESTIMATED)}",
            )
        with memory_limit(allowed):
            asked = {flag for flag in GLOBAL_FLAGS if flag in arguments}
            return _dispatch(rest, asked, thread_count(values.get("--threads")))
    except SystemExit as stop:  # after --help
        return stop.code if isinstance(stop.code, int) else EXIT_BAD_INPUT
    except BrokenPipeError:
        # The reader (head, less) has gone; Python would complain again when it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except (Exception, KeyboardInterrupt) as error:
        if debug:
            traceback.print_exc()
        name = _command_of(rest)
        # Libraries make other errors of it: "initialization failed" while they are imported.
        why = KeyboardInterrupt(_received[-1]) if _received else error
        command = COMMANDS[name] if name else None
        message, code = describe_error(why, command, wrote=_n_written() > n_before)
        message = printable(shortened(message))
        print(f"geraf2: {message}", file=sys.stderr)
        if "--json" in arguments:
            print(json.dumps({"command": name, "exit_code": code, "error": message}))
        return code


def _command_of(arguments: Sequence[str]) -> str | None:
    return next((word for word in arguments if word in COMMANDS), None)


def describe_error(
    error: BaseException, command: Command | None = None, *, wrote: bool = True
) -> tuple[str, int]:
    """One line for the user of a command, and the exit code; `wrote`: whether it wrote a file."""
    after_stop = f"; {command.after_stop if wrote else 'nothing was written'}" if command else ""
    library = missing_library(error)
    if library or isinstance(error, UserError):
        return f"error: {library or _one_line(error)}", EXIT_BAD_INPUT
    if isinstance(error, KeyboardInterrupt):
        number = error.args[0] if error.args else signal.SIGINT
        return f"interrupted{after_stop}", EXIT_SIGNAL + int(number)
    if lacks_memory(error):
        detail = f" ({_one_line(error)})" if str(error) else ""
        return (
            f"error: not enough memory{detail}; 'geraf2 info' estimates what a run takes",
            EXIT_BAD_INPUT,
        )
    if isinstance(error, OSError):
        if error.errno == errno.ENOSPC:
            where = f" while writing {error.filename}" if error.filename else ""
            return f"error: the disk is full{where}{after_stop}", EXIT_BAD_INPUT
        return f"error: {_one_line(error)}", EXIT_BAD_INPUT
    return (
        f"internal error: {type(error).__name__}: {_one_line(error)}; --debug shows where",
        EXIT_BUG,
    )


def missing_library(error: BaseException) -> str:
    """State which library the kernels lack, and what to do; empty for another error."""
    library, found, _ = str(error).partition(": cannot open shared object file")
    if not isinstance(error, ImportError) or not found:
        return ""
    install = " (Debian, Ubuntu: apt install libembree4-4 or libembree3-3)" * ("embree" in library)
    return f"the kernels need {library}, which is not installed{install}"


def _require_environment() -> None:
    """Raise UserError where a variable would end the process, or every kernel."""
    if os.environ.get("OMP_NUM_THREADS"):
        from geraf2._bounds import MAX_THREADS  # noqa: PLC0415 - `--help` does without

        number = os.environ["OMP_NUM_THREADS"].partition(",")[0].strip()
        if number.isdecimal() and (len(number) > 9 or int(number) > MAX_THREADS):
            expected = f"at most {MAX_THREADS}"
            raise UserError(
                what="too many threads", where="OMP_NUM_THREADS", expected=expected, got=number
            )
    if os.environ.get("GERAF2_SIMD"):
        from geraf2.ops import simd_level  # noqa: PLC0415 - as above

        try:
            simd_level()
        except ValueError as error:
            raise UserError(str(error)) from None


def _n_written() -> int:
    atomic = sys.modules.get("geraf2.io.atomic")  # not loaded: nothing was written
    return atomic.n_written() if atomic else 0


def help_text() -> str:
    """Text of `geraf2 --help`."""
    width = max(len(name) for name in COMMANDS)
    lines = [
        "usage: geraf2 COMMAND ... [FLAGS]",
        "",
        "Sees through boxes: metric surfaces from near-field FMCW radar scans.",
        "",
        *(f"  {name:<{width}}  {command.summary}" for name, command in COMMANDS.items()),
        "",
        "  geraf2 COMMAND --help   flags of a command, in any order",
        "  geraf2 --version        version",
        "  --json                  one JSON object on stdout, all else on stderr",
        "  --quiet, --verbose      warnings and errors alone, or the log of every module",
        "  --threads N             use at most N threads; all when not given",
        "  --debug                 full traceback on errors",
        "  --max-memory GIB        refuse work that is estimated to take more memory; of",
        f"                          {', '.join(ESTIMATED)}",
    ]
    return "\n".join(lines)


def _dispatch(arguments: list[str], asked: AbstractSet[str], n_threads: int | None) -> int:
    index = next((i for i, a in enumerate(arguments) if a in COMMANDS), None)
    words = [argument for argument in arguments if not argument.startswith("-")]
    if index is None and not words:
        print(help_text())
        return EXIT_OK if "--help" in arguments or "-h" in arguments else EXIT_BAD_INPUT
    from geraf2.cli._fields import did_you_mean  # noqa: PLC0415 - `--help` does without both
    from geraf2.cli._flags import parse  # noqa: PLC0415

    if index is None:
        what = f"unknown command {words[0]!r}{did_you_mean(words[0], COMMANDS)}"
        raise UserError(what, expected=", ".join(COMMANDS))
    # Flags may come before the command as well as after it.
    name, rest = arguments[index], arguments[:index] + arguments[index + 1 :]
    command = COMMANDS[name]
    module = cast("_CommandModule", importlib.import_module(f"geraf2.cli.{command.module}"))
    description = cleandoc(module.Config.__doc__ or command.summary)
    default = module.defaults(rest) if hasattr(module, "defaults") else None
    prog = f"geraf2 {name}"
    config = parse(module.Config, rest, prog=prog, description=description, default=default)
    from geraf2.cli._console import show_output  # noqa: PLC0415 - the module has loaded it

    with show_output(
        name,
        as_json="--json" in asked,
        quiet="--quiet" in asked,
        verbose="--verbose" in asked,
        n_threads=n_threads,
    ) as result:
        result["exit_code"] = module.main(config)
    return int(result["exit_code"])


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
