from helpers.found_boxes import box_found_once  # noqa: F401 - applies to all tests here
