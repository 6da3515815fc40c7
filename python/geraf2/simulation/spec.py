"""Settings of a simulation, read from TOML; unknown keys are rejected."""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Interval

from geraf2._bounds import Bounded, CellM, Degrees, LengthM, NotNegative, SignedM
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.io.scan_file import ScanFile, read_scan_file
from geraf2.io.toml import from_table, read_table
from geraf2.scene import Wall, Waveform
from geraf2.simulation.belt_spec import BeltSpec
from geraf2.simulation.world import ErrorM, WorldSpec

AWR1843 = Waveform(
    start_frequency_hz=77.3704e9,
    chirp_slope_hz_per_s=70.15e12,
    sample_rate_hz=625e3,
    n_samples=32,
    path_bias_m=0.15,
)
"""Chirp of a TI AWR1843, decimated to 32 samples: the default of a spec's waveform."""
CORRUGATED = {"thickness_m": 0.004, "permittivity": 1.6}
"""Corrugated board: the default of a wall's material."""

_SizeM = Annotated[float, Interval(gt=0.0, le=10.0)]
_OffsetM = Annotated[float, Interval(ge=-10.0, le=10.0)]
_StepM = Annotated[float, Interval(ge=1e-4, le=10.0)]

UpAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


@dataclass(frozen=True, kw_only=True)
class FigureSpec(Bounded):
    """The metal object: a mesh file or a procedural object, scaled, turned and placed."""

    name: str | None = None
    """Procedural object (see :data:`geraf2.simulation.figures.FIGURES`); or give `mesh`."""
    mesh: str | None = None
    """Mesh file (PLY, OBJ, STL), relative to the TOML file; or give `name`."""
    height_m: _SizeM = 0.13
    """Vertical extent after turning [m]."""
    up: UpAxis = "+z"
    """Axis of the file that points up."""
    turn_deg: Degrees = 0.0
    """Turn about the vertical after that, counter-clockwise from above [degrees]."""
    center_m: tuple[_OffsetM, _OffsetM, _OffsetM] = (0.0, 0.0, 0.0)
    """Where the middle of the bounding box comes to lie [m]."""
    smooth_subdivisions: Annotated[int, Interval(ge=0, le=4)] = 0
    """Rounds of Loop subdivision: makes a coarse mesh smooth (its facets would flash)."""
    reflectivity: Annotated[float, Interval(gt=0.0, le=100.0)] = 1.0
    """Amplitude of the object's echo over that of metal; printed plastic has about 0.25."""
    roughness_rms_m: ErrorM = 0.0
    """Rms displacement of the echoing surface from the truth, per coordinate [m]."""
    roughness_length_m: LengthM = 0.003
    """Correlation length of that displacement [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.name is None) == (self.mesh is None):
            msg = f"figure needs either name or mesh, got name={self.name!r}, mesh={self.mesh!r}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class RingSpec(Bounded):
    """Planes at one elevation: above the box, below it, tilted, or nearer than the others."""

    n_poses: Annotated[int, Interval(ge=1, le=1_000_000)] = 1
    """Planes, equally spaced over `arc_deg`."""
    elevation_deg: Annotated[float, Interval(ge=-90.0, le=90.0)] = 0.0
    """Of a plane's centre above the horizontal, seen from the frame's origin; 90: above the box
    [degrees]."""
    tilt_deg: Annotated[float, Interval(ge=-90.0, le=90.0)] = 0.0
    """Angle by which the viewing direction lies above that towards the axis [degrees]."""
    start_angle_deg: Degrees = 0.0
    """Angle of the first plane's centre, from x to y [degrees]."""
    arc_deg: Annotated[float, Interval(gt=0.0, le=3600.0)] = 360.0
    """Angle over which the planes are spread; 360 closes the circle [degrees]."""
    height_m: SignedM = 0.0
    """Height of a plane's centre above that of its elevation [m]."""
    standoff_m: LengthM | None = None
    """Distance of a plane's centre from the origin; the scan's by default [m]."""
    aperture_m: tuple[LengthM, LengthM] | None = None
    """Width and height of a plane; the scan's by default [m]."""
    spacing_m: _StepM | None = None
    """Distance of neighbouring antennas; the scan's by default [m]."""


@dataclass(frozen=True, kw_only=True)
class ScanSpec(Bounded):
    """Planes around a turntable whose axis is the frame's z axis."""

    n_poses: Annotated[int, Interval(ge=0, le=1_000_000)] = 36
    """Planes, equally spaced over `arc_deg`; 0 where `rings` or `file` give all planes."""
    start_angle_deg: Degrees = 0.0
    """Angle of the first plane's centre, from x to y [degrees]."""
    arc_deg: Annotated[float, Interval(gt=0.0, le=3600.0)] = 360.0
    """Angle over which the planes are spread; 360 closes the circle [degrees]."""
    aperture_m: tuple[LengthM, LengthM] = (0.14, 0.25)
    """Width and height of a plane [m]."""
    spacing_m: _StepM = 0.003
    """Distance of neighbouring antennas [m]."""
    standoff_m: LengthM = 0.40
    """Distance of a plane's centre from the axis [m]."""
    height_m: SignedM = 0.0
    """Height of a plane's centre [m]."""
    tx_rx_distance_m: Annotated[float, Interval(ge=-1.0, le=1.0)] = 0.005
    """Horizontal distance of transmitter and receiver [m]."""
    pattern_exponent: Annotated[int, Interval(ge=0, le=100)] = 0
    """n of the amplitude pattern cos^n of each antenna; 0 is isotropic."""
    position_jitter_rms_m: ErrorM = 0.0
    """Error of each antenna's recorded position, per coordinate [m]."""
    position_drift_rms_m: ErrorM = 0.0
    """Slow error of the recorded positions along the antennas of each plane, per coordinate [m]."""
    axis_offset_m: tuple[_OffsetM, _OffsetM] = (0.0, 0.0)
    """Offset of the true turntable axis from the one that the recorded positions assume, towards
    the radar and horizontally across [m]."""
    rings: tuple[RingSpec, ...] = ()
    """Further planes, after the others."""
    file: str | None = None
    """Scan file (JSON) whose planes, lines and antennas replace the `n_poses` planes,
    relative to the TOML file."""
    sweeps: ScanFile | None = None
    """Content of that file, once read."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.n_poses or self.rings or self.file or self.sweeps):
            msg = "n_poses must be at least 1 where there are no rings, got 0"
            raise ValueError(msg)

    @property
    def n_planes(self) -> int:
        """Planes of the whole scan."""
        swept = 0 if self.sweeps is None else len(self.sweeps.planes)
        return swept + sum(ring.n_poses for ring in self.all_rings)

    @property
    def all_rings(self) -> tuple[RingSpec, ...]:
        """All rings, that of `n_poses` first, with their defaults filled in."""
        first = RingSpec(
            n_poses=max(1, self.n_poses),
            start_angle_deg=self.start_angle_deg,
            arc_deg=self.arc_deg,
            height_m=self.height_m,
        )
        return tuple(
            replace(
                ring,
                standoff_m=ring.standoff_m or self.standoff_m,
                aperture_m=ring.aperture_m or self.aperture_m,
                spacing_m=ring.spacing_m or self.spacing_m,
            )
            for ring in ((first,) if self.n_poses and self.sweeps is None else ()) + self.rings
        )


@dataclass(frozen=True, kw_only=True)
class DisturbanceSpec(Bounded):
    """Noise and clutter around the object."""

    snr_db: Annotated[float, Interval(ge=-300.0)] = 20.0
    """Mean abs(signal)^2 over mean abs(noise)^2, both over all samples; inf: no noise [dB]."""
    scatterer_energy_fraction: NotNegative = 0.0
    """Energy of random weak scatterers (bubble wrap) over that of the object's echo."""
    n_scatterers: Annotated[int, Interval(ge=1, le=10**7)] = 400
    """Number of scatterers, uniform in the innermost box outside the object."""
    far_walls: bool = True
    """Whether inner sides of walls echo, with their multipath via the object; false: they do not
    echo, as if lined with an absorber."""
    channel_phase_rms_deg: Annotated[float, Interval(ge=0.0, le=3600.0)] = 0.0
    """Unknown phase of each channel, the same in all planes [degrees]."""
    n_channels: Annotated[int, Interval(ge=1, le=4096)] = 8
    """Number of channels: antenna i of a plane belongs to channel i modulo this."""


@dataclass(frozen=True, kw_only=True)
class NumericsSpec(Bounded):
    """Resolution of surfaces and apertures."""

    max_facet_edge_m: CellM = 0.0012
    """Longest edge of the object's facets, at most a third of the shortest wavelength [m]."""
    wall_patch_m: CellM = 0.005
    """Side of the walls' patches; 5 mm are exact to 1 % of the flash, 8 mm to 7 % [m]."""
    antenna_block_m: LengthM = 0.04
    """Antennas that share one visibility test lie within this [m]."""


@dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """A whole simulated capture, lengths in metres.

    Raises
    ------
    ValueError
        For values that make no sense.

    Examples
    --------
    >>> spec = geraf2.examples.small_scene()
    >>> spec.figure.height_m, spec.scan.n_poses, spec.walls[0].size_m
    (0.06, 6, (0.16, 0.16, 0.16))
    """

    figure: FigureSpec
    """The object."""
    inside: FigureSpec | None = None
    """Metal object in the air inside the figure, which then is a shell of plastic."""
    walls: tuple[Wall, ...] = ()
    """Boxes around it, outermost first; none: the object stands free."""
    waveform: Waveform = AWR1843
    """The chirp."""
    scan: ScanSpec = field(default_factory=ScanSpec)
    """Positions of the antennas."""
    belt: BeltSpec | None = None
    """A belt with fixed arrays, whose planes replace those of the scan."""
    disturbance: DisturbanceSpec = field(default_factory=DisturbanceSpec)
    """Noise and clutter."""
    world: WorldSpec = field(default_factory=WorldSpec)
    """Errors beyond an ideal scan."""
    numerics: NumericsSpec = field(default_factory=NumericsSpec)
    """Resolution."""

    def __post_init__(self) -> None:
        highest_hz = float(self.waveform.frequencies_hz.max())
        limit_m = SPEED_OF_LIGHT_M_PER_S / highest_hz / 3.0
        if self.numerics.max_facet_edge_m > limit_m:
            msg = (
                f"numerics.max_facet_edge_m must be at most a third of the wavelength at "
                f"{highest_hz / 1e9:.1f} GHz, {limit_m:.6f} m, got "
                f"{self.numerics.max_facet_edge_m}"
            )
            raise ValueError(msg)
        if self.inside is not None and not self.world.figure_shell_m:
            msg = "inside needs a figure that is a shell, got world.figure_shell_m = 0"
            raise ValueError(msg)
        if self.inside is not None and self.inside.roughness_rms_m:
            msg = f"inside.roughness_rms_m must be 0, got {self.inside.roughness_rms_m}"
            raise ValueError(msg)
        near = min((min(wall.size_m[:2]) for wall in self.walls), default=0.0) / 2.0
        if self.scan.standoff_m <= near:
            msg = f"scan.standoff_m puts the antennas into the box, got {self.scan.standoff_m}"
            raise ValueError(msg)
        for outer, inner in zip(self.walls, self.walls[1:], strict=False):
            for axis in range(3):
                reach = abs(inner.center_m[axis] - outer.center_m[axis]) + inner.size_m[axis] / 2
                if reach > outer.size_m[axis] / 2 - outer.thickness_m:
                    msg = (
                        f"walls must be nested, outermost first, got {inner.size_m} at "
                        f"{inner.center_m} not inside {outer.size_m} at {outer.center_m}"
                    )
                    raise ValueError(msg)


def load_spec(path: Path | str) -> SceneSpec:
    r"""Read a simulation spec from TOML; mesh paths are taken relative to the file.

    path: the TOML file; keys as the fields of :class:`SceneSpec` and its parts, SI units [m, Hz].

    Returns the spec. Raises UserError where the file cannot be read or has an unknown key.

    >>> from pathlib import Path
    >>> text = "[figure]\nname = 'llama'\n[[walls]]\nsize_m = [0.2, 0.2, 0.2]\n"
    >>> n = Path("spec.toml").write_text(text)
    >>> geraf2.load_spec("spec.toml").walls[0].size_m
    (0.2, 0.2, 0.2)
    """
    path = Path(path)
    spec = parse_spec(read_table(path), where=path)
    if spec.scan.file is not None:
        spec = use_scan_file(spec, path.parent / spec.scan.file)
    spec = replace(spec, figure=_beside(path, spec.figure))
    return spec if spec.inside is None else replace(spec, inside=_beside(path, spec.inside))


def _beside(path: Path, figure: FigureSpec) -> FigureSpec:
    """Figure whose mesh is taken relative to a file."""
    return figure if figure.mesh is None else replace(figure, mesh=str(path.parent / figure.mesh))


def use_scan_file(spec: SceneSpec, path: Path) -> SceneSpec:
    """Spec whose planes are those of a scan file and its rings."""
    return replace(spec, scan=replace(spec.scan, file=None, sweeps=read_scan_file(path)))


def parse_spec(values: dict[str, Any], *, where: object = None) -> SceneSpec:
    """Check a decoded TOML table and fill in the defaults.

    values: nested tables.
    where: named in the error message.
    """
    filled = dict(values)
    if isinstance(waveform := values.get("waveform"), dict):
        filled["waveform"] = asdict(AWR1843) | waveform
    if isinstance(walls := values.get("walls"), list | tuple):
        filled["walls"] = [CORRUGATED | wall if isinstance(wall, dict) else wall for wall in walls]
    return from_table(filled, SceneSpec, where)
