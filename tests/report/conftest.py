from helpers.drawing import drawn_coarsely  # noqa: F401 - applies to all tests here
