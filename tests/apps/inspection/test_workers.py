import threading

import pytest

from geraf2.apps.inspection.workers import Workers


@pytest.mark.parametrize("num_threads", [1, 3])
def test_results_and_their_reports_are_in_order(num_threads):
    stated, caller = [], threading.get_ident()

    def say(number):
        assert threading.get_ident() == caller
        stated.append(number)

    with Workers(num_threads) as workers:
        assert workers.each(pow, range(5), [2] * 5, on_result=say) == [0, 1, 4, 9, 16]
    assert stated == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("num_threads", [1, 3])
def test_an_error_of_a_task_is_raised(num_threads):
    with Workers(num_threads) as workers, pytest.raises(ZeroDivisionError):
        workers.each(lambda x: 1 / x, [1, 0])


def test_tasks_run_in_parallel():
    meet = threading.Barrier(2, timeout=20.0)
    with Workers(2) as workers:
        assert set(workers.each(lambda _: meet.wait(), range(2))) == {0, 1}
