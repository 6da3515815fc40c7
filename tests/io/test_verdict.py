"""The verdict in run.json."""

import pytest
from tests.helpers.run_folders import record_run

from geraf2.errors import UserError
from geraf2.io.run_folder import RunFolder
from geraf2.io.verdict import VERDICT_STAGE, Cause, Trust, Verdict

FOUND = Verdict(
    trust=Trust.NOT_TO_BE_TRUSTED,
    probability_of_failure=0.97,
    causes=(
        Cause("sense", "planes fit better in the other sense", "reconstruct with --reverse-turn"),
    ),
    tests={"sense": {"log_odds": 12.5}},
)


def test_a_verdict_is_read_from_run_json_as_it_was_written(tmp_path):
    record_run(tmp_path, numbers={"mesh": {}, VERDICT_STAGE: FOUND.numbers()})
    stages = RunFolder.read(tmp_path).stages
    assert Verdict.from_numbers(stages[VERDICT_STAGE].numbers) == FOUND
    assert Verdict.from_numbers(stages["mesh"].numbers) is None


@pytest.mark.parametrize(
    "broken",
    [
        {"verdict": "perhaps"},
        {"causes": [{"name": "sense"}]},
        {"probability_of_failure": None},
        {"tests": ...},
    ],
)
def test_a_broken_verdict_is_bad_input(tmp_path, broken):
    numbers = {k: v for k, v in (FOUND.numbers() | broken).items() if v is not ...}
    record_run(tmp_path, numbers={VERDICT_STAGE: numbers})
    with pytest.raises(UserError, match=f"run.json: {VERDICT_STAGE}"):
        RunFolder.read(tmp_path)
