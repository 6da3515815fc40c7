"""From a learned distance field to the signal of an antenna: lensless sampling and rendering."""

from geraf2.rendering.lensless import LenslessRenderer, RenderConfig, RenderedSignal, VisionPrior
from geraf2.rendering.sampling import LenslessSampler, PrimaryRays, SamplingConfig

__all__ = [
    "LenslessRenderer",
    "LenslessSampler",
    "PrimaryRays",
    "RenderConfig",
    "RenderedSignal",
    "SamplingConfig",
    "VisionPrior",
]
