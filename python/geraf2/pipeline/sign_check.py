"""Diagnosis of errors that a wrong sign of the phase causes."""

from collections.abc import Iterator
from contextlib import contextmanager

from geraf2.errors import UserError
from geraf2.imaging.phase_sign import find_phase_sign
from geraf2.scene import Capture


@contextmanager
def explain_sign_errors(
    capture: Capture, where: object, num_threads: int | None = None
) -> Iterator[None]:
    """Replace an error inside the block by that of a wrong sign of the phase, if it is the cause.

    where: name of the capture in the message.
    """
    try:
        yield
    except UserError:
        require_sign(capture, where, num_threads)
        raise


def require_sign(capture: Capture, where: object, num_threads: int | None = None) -> None:
    """Raise UserError for a capture whose phase certainly has the wrong sign."""
    sign = find_phase_sign(capture.poses, capture.waveform, num_threads=num_threads)
    if sign.sign > 0 and sign.is_clear:
        raise UserError(
            what="the phase has the wrong sign",
            where=where,
            expected="exp(-j 2 pi f d / c) for a path d",
            got=f"a signal that focuses {sign.evidence:.2g} times better as exp(+j...)",
            hint="import it again with the other --phase-sign, -1 or +1",
        )
