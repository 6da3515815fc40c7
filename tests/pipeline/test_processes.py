"""Calls in processes of their own."""

import os
import time

import pytest

from geraf2.errors import UserError
from geraf2.pipeline.processes import Processes


def test_a_call_reports_its_own_time_and_errors():
    processes = Processes()
    value, busy = processes.call(sum, range(20_000_000))
    assert value == 199_999_990_000_000
    assert 0.1 <= busy < 10.0
    _, idle = processes.call(time.sleep, 0.5)
    assert idle < busy
    with pytest.raises(UserError, match=r"ValueError: .*'no'"):
        processes.call(int, "no")
    with pytest.raises(UserError, match="ended by SIGABRT"):
        processes.call(os.abort)
    with pytest.raises(UserError, match="exit code 3"):
        processes.call(os._exit, 3)
    assert processes.call(print, "an answer")[0] is None
