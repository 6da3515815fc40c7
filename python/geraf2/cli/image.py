"""`geraf2 image`: matched-filter volume of a scene."""

from geraf2.pipeline.image import Config, main

__all__ = ["Config", "main"]
