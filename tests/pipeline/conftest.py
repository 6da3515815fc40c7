from helpers.drawing import drawn, not_drawn  # noqa: F401 - fixtures of the tests here
from helpers.found_boxes import box_found_once  # noqa: F401 - as above
