"""Signed distance as a multilayer perceptron."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize
from torch.nn.utils.parametrizations import weight_norm

from geraf2._validation import require_each, require_least, require_positive
from geraf2.fields.sdf_field import CubeDomain, Distance, SdfField, SdfSample, require_points
from geraf2.learned.fields.encoding import encoded_size, octave_weights, positional_encoding

_POINTS_AT_ONCE = 1024


@dataclass(frozen=True, kw_only=True)
class SdfMlpConfig:
    """Size and start of the network: the paper's, which are those of NeuS with more octaves."""

    n_layers: int = 8
    """Hidden layers."""
    width: int = 256
    """Neurons of a hidden layer."""
    skip: int = 4
    """Hidden layer to which the encoded point is appended again; 0 for none."""
    n_octaves: int = 10
    """Octaves of the positional encoding."""
    softplus_beta: float = 100.0
    """Sharpness of the activation; infinite would be a rectifier."""
    init_radius: float = 0.5
    """Radius of the sphere that the network starts from, in units of the domain's half side."""
    fit_steps: int = 400
    """Steps of the fit of `initialise`."""
    fit_points: int = 4096
    """Random points of each of these steps."""
    fit_rate: float = 1e-3
    """Learning rate of that fit."""

    def __post_init__(self) -> None:
        require_least(self, n_layers=1, width=1, n_octaves=0)
        if not 0 <= self.skip < self.n_layers:
            msg = f"skip must be from 0 to n_layers - 1 = {self.n_layers - 1}, got {self.skip}"
            raise ValueError(msg)
        if self.skip and self.width <= encoded_size(self.n_octaves):
            msg = (
                f"width must exceed the {encoded_size(self.n_octaves)} numbers of the encoding "
                f"that the skip appends, got {self.width}"
            )
            raise ValueError(msg)
        require_each(require_positive, self, "softplus_beta", "init_radius")


class SdfMlp(SdfField):
    """Perceptron with encoded input, one skip, weight normalisation and geometric start.

    domain: cube that is normalised to [-1, 1]; the network is defined outside it as well.
    seed: of the initial weights.

    All octaves of the encoding are active until :meth:`open_octaves` is called.

    Starts as a sphere about the middle of the domain: Atzmon and Lipman, SAL, 2020, section 5,
    with zero weights of the encoding's sines as in Yariv et al. 2020.
    """

    n_open: Tensor
    """Number of active octaves of the encoding, without dimensions."""

    def __init__(
        self, domain: CubeDomain, config: SdfMlpConfig | None = None, *, seed: int = 0
    ) -> None:
        super().__init__(domain)
        self.config = config if config is not None else SdfMlpConfig()
        generator = torch.Generator().manual_seed(seed)
        n_octaves = torch.tensor(float(self.config.n_octaves))
        self.register_buffer("n_open", n_octaves, persistent=False)
        self.layers = nn.ModuleList()
        size = encoded_size(self.config.n_octaves)
        n_in = size
        for number in range(self.config.n_layers + 1):
            is_last = number == self.config.n_layers
            n_out = 1 if is_last else self.config.width
            if number + 1 == self.config.skip:
                n_out -= size
            layer = nn.Linear(n_in, n_out)
            self._start(layer, number, generator)
            self.layers.append(weight_norm(layer))
            n_in = self.config.width if number + 1 == self.config.skip else n_out
        self.activation = nn.Softplus(beta=self.config.softplus_beta)
        self._scale_start(generator)

    def open_octaves(self, n_open: float) -> None:
        """Activate the first octaves of the encoding; with 2.5 the third one by half.

        Weights of inactive octaves have no gradient, and stay zero.
        """
        if not 0.0 <= n_open <= self.config.n_octaves:
            msg = f"n_open must be from 0 to n_octaves = {self.config.n_octaves}, got {n_open}"
            raise ValueError(msg)
        self.n_open.fill_(n_open)

    @torch.no_grad()
    def _scale_start(self, generator: torch.Generator) -> None:
        # A network as wide as this is a cone of slope one in expectation only: eight random
        # layers of 256 had slopes from 0.7 to 1.3. The last layer compensates that factor.
        direction = torch.randn((1024, 3), generator=generator)
        lengths = torch.linalg.vector_norm(direction, dim=1, keepdim=True)
        radius = torch.rand((1024, 1), generator=generator)
        center = torch.tensor(self.domain.center_m)
        points = center + self.domain.half_side_m * radius * direction / lengths
        cone = self._evaluate(points)[:, 0] + self.config.init_radius
        last = self.layers[-1]
        scale = radius.square().sum() / (cone * radius[:, 0]).sum()
        last.weight = torch.as_tensor(last.weight) * scale

    @torch.no_grad()
    def _start(self, layer: nn.Linear, number: int, generator: torch.Generator) -> None:
        config = self.config
        n_waves = encoded_size(config.n_octaves) - 3
        weight, bias = layer.weight, layer.bias
        bias.zero_()
        if number == config.n_layers:
            weight.normal_(mean=math.sqrt(math.pi / weight.shape[1]), std=1e-4, generator=generator)
            bias.fill_(-config.init_radius)
            return
        weight.normal_(std=math.sqrt(2.0 / weight.shape[0]), generator=generator)
        if n_waves and (number == 0 or (config.skip and number == config.skip)):
            weight[:, -n_waves:] = 0.0

    def _evaluate(self, points: Tensor) -> Tensor:
        n_octaves = self.config.n_octaves
        weights = octave_weights(self.n_open.to(points.dtype), n_octaves)
        encoded = positional_encoding(self.domain.normalise(points), n_octaves, weights)
        hidden = encoded
        for number, layer in enumerate(self.layers):
            if number and number == self.config.skip:
                hidden = torch.cat([hidden, encoded], dim=1) / math.sqrt(2.0)
            hidden = layer(hidden)
            if number < self.config.n_layers:
                hidden = self.activation(hidden)
        return hidden

    def forward(self, points: Tensor) -> SdfSample:
        """Value and gradient at points (n, 3) [m].

        The gradient may be differentiated, except under `torch.no_grad`.
        """
        require_points(points)
        # With more points at once, activations leave the cache: 24,000 points take 1.6 instead of
        # 1.4 times the time of their matrix products.
        with parametrize.cached():
            parts = [self._sample(part) for part in torch.split(points, _POINTS_AT_ONCE)]
        if len(parts) == 1:
            return parts[0]
        return SdfSample(*map(torch.cat, zip(*parts, strict=True)))

    def _sample(self, points: Tensor) -> SdfSample:
        record = torch.is_grad_enabled()
        with torch.enable_grad():
            positions = points if points.requires_grad else points.detach().requires_grad_()
            value = self._evaluate(positions)[:, 0] * self.domain.half_side_m
            (gradient,) = torch.autograd.grad(value.sum(), positions, create_graph=record)
        if not record:
            value, gradient = value.detach(), gradient.detach()
        return SdfSample(value, gradient)

    def value(self, points: Tensor) -> Tensor:
        """Value alone at points (n, 3) [m] -> (n,) [m]."""
        require_points(points)
        return self._evaluate(points)[:, 0] * self.domain.half_side_m

    def initialise(self, target: Distance, *, seed: int = 0) -> None:
        """Fit the network to a signed distance on random points of the domain.

        Least squares of the value, by Adam with a rate that falls to zero. The residual for a box
        after 400 steps is about 1 % of the half side.
        """
        generator = torch.Generator().manual_seed(seed)
        dtype = next(self.parameters()).dtype
        optimiser = torch.optim.Adam(self.parameters(), lr=self.config.fit_rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, self.config.fit_steps)
        center = torch.tensor(self.domain.center_m, dtype=torch.float64)
        for _ in range(self.config.fit_steps):
            unit = torch.rand((self.config.fit_points, 3), dtype=torch.float64, generator=generator)
            points = center + self.domain.half_side_m * (2.0 * unit - 1.0)
            wanted = torch.from_numpy(target(points.numpy())).to(dtype)
            error = (self.value(points.to(dtype)) - wanted) / self.domain.half_side_m
            optimiser.zero_grad()
            torch.autograd.backward(error.square().mean())
            optimiser.step()
            schedule.step()
        optimiser.zero_grad()
