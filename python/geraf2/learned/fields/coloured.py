"""What a photo renderer asks of a surface with a colour."""

from abc import ABC, abstractmethod

from torch import Tensor, nn

from geraf2.learned.fields.sdf_mlp import FeatureSample


class ColouredField(nn.Module, ABC):
    """A signed distance with a colour that depends on where it is seen from."""

    @abstractmethod
    def value(self, points: Tensor) -> Tensor:
        """Signed distance (n_points,) [m] at points (n_points, 3) [m]; cheap, no gradient."""

    @abstractmethod
    def surface_sample(self, points: Tensor) -> FeatureSample:
        """Signed distance [m], gradient and features at points (n_points, 3) [m].

        Differentiable with respect to the parameters.
        """

    @abstractmethod
    def shade(
        self, points: Tensor, directions: Tensor, sample: FeatureSample, weight: Tensor
    ) -> Tensor:
        """Colour of rays, not yet composed with what is behind.

        points: samples of each ray, (n_rays, n, 3) [m].
        directions: unit vectors from the camera, (n_rays, 3).
        sample: `surface_sample` at these points, ray by ray.
        weight: weight of each sample, (n_rays, n).

        Returns (n_rays, 3), each at most the sum of the ray's weights.
        """
