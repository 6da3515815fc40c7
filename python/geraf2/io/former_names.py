"""Former names of presets and settings: each is refused in a line that states the present one."""

PRESETS = {"glint": "fast", "hybrid": "best"}
"""Present name of a preset by its former one."""
RENAMED = {
    "hybrid.shadow_clearance_m": "refine.outline_clearance_m",
    "hybrid.fit.outline_clearance_m": "refine.outline_clearance_m",
    "hybrid.fit.outline_weight": "refine.outline_weight",
    "hybrid.fit.more_weight": "refine.rim_weight",
    "hybrid": "refine",
}
"""Present name of a setting, or of a section, by its former one; the first that matches counts."""
REMOVED = frozenset(
    {
        "autofocus.min_gain",
        "fit.absence_angle_rad",
        "fit.absence_clearance_m",
        "fit.absence_depth_m",
        "fit.absence_margin_m",
        "fit.absence_reach_m",
        "fit.absence_wall_m",
        "fit.absence_weight",
        "fit.coarse_spacing_m",
        "fit.continuation_weight",
        "fit.more_weight",
        "fit.normal_power",
        "fit.normal_weight",
        "fit.outline_clearance_m",
        "fit.outline_weight",
        "fit.position_power",
        "fit.strong_quantile",
        "fit.support",
        "fit.support_reach_m",
        "glints.cluster_link_m",
        "glints.cluster_share",
        "glints.neighbor_angle_rad",
        "glints.neighbor_count",
        "glints.neighbor_offset_m",
        "glints.neighbor_radius_m",
        "heatmaps",
        "refine.clutter",
        "refine.few_planes_voxel_scales",
        "refine.few_planes_weight",
        "refine.links",
        "refine.plain_far_m",
        "refine.plain_near_m",
        "refine.plain_share",
        "refine.rim.aperture_step_m",
        "refine.rim.chord_m",
        "refine.rim.reach_m",
        "refine.rim.rounds",
        "refine.rim.strength_db",
        "refine.silhouettes.edge",
        "refine.silhouettes.wall_flash",
        "refine.voxel_scales",
    }
)
"""Settings and sections without a successor, below the present names of their sections; those of
`fit` also below `refine.fit`."""


def former_preset(name: str) -> str:
    """Line about a preset that has another name now; empty for any other name."""
    return f"preset {name!r} is called {PRESETS[name]!r} now" if name in PRESETS else ""


def former_setting(name: str) -> str:
    """Line about a setting that was renamed or removed; empty for any other name.

    name: dotted key of config.toml, or flag.
    """
    is_flag = name.startswith("--")
    key = name.removeprefix("--").replace("-", "_") if is_flag else name
    present = key
    for old, new in RENAMED.items():
        if f"{key}.".startswith(f"{old}."):
            present = new + key.removeprefix(old)
            break
    shared = present.removeprefix("refine.") if present.startswith("refine.fit.") else present
    if any(f"{shared}.".startswith(f"{removed}.") for removed in REMOVED):
        return f"{name} was removed and has no successor: leave it out"
    if present == key:
        return ""
    return f"{name} is called {'--' + present.replace('_', '-') if is_flag else present} now"
