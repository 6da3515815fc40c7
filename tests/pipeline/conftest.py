from helpers.drawing import drawn, not_drawn  # noqa: F401 - fixtures of the tests here
