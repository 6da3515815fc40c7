import pytest

import geraf2
from geraf2.cli.main import main
from geraf2.errors import UserError, speaking_of_flags


@pytest.mark.parametrize(
    ("what", "in_python"),
    [
        ("--n-samples must be at least 1", "n_samples must be at least 1"),
        ("give --box X Y Z, or --los", "give box X Y Z, or los"),
        ("run 'geraf2 info SCENE --figure'", "run 'geraf2 info SCENE --figure'"),
        ("a -- b and well--known", "a -- b and well--known"),
    ],
)
def test_an_error_speaks_of_flags_on_the_command_line_and_of_arguments_in_python(what, in_python):
    error = UserError(what)
    assert str(error) == in_python
    with speaking_of_flags():
        assert str(error) == what
    assert str(error) == in_python


def test_both_doors_name_the_setting_as_it_is_given_there(capsys):
    with pytest.raises(UserError, match=r"^give box, or depth of a single plane$"):
        geraf2.plan(geraf2.PlanOptions())
    assert main(["plan"]) == 2
    assert "give --box, or --depth of a single plane" in capsys.readouterr().err
