"""First half of the table: what is to be simulated."""

from bad_inputs.table import bad, keys, put, swap, toml

SPECS = [
    *keys(
        "simulate spec.toml out",
        "spec.toml",
        """
        figure.name 3
        figure.height_m 0 -1 nan 100 1e30
        figure.reflectivity 0 nan inf
        figure.roughness_rms_m -1 1.0 nan
        figure.smooth_subdivisions -1 9
        figure.center_m [0,0]|[nan,0,0]|[99,0,0]
        figure.typo 1
        waveform.start_frequency_hz 77 nan
        waveform.n_samples 0 1000000000
        scan.n_poses 0 -1 1000000000 2.5
        scan.spacing_m 0 nan 1e-7
        scan.standoff_m 0 0.05 nan 1e9
        scan.aperture_m [0,0.1]|[nan,0.1]|[1000,1000]
        scan.arc_deg 0 nan
        scan.tx_rx_distance_m nan 100.0
        scan.pattern_exponent -1 100000
        walls.size_m [0.05,0.05,0.05]|[0,1,1]
        walls.thickness_m 0 0.2 nan
        walls.permittivity 0.5 nan
        numerics.max_facet_edge_m 0 nan 1e-7 1
        numerics.wall_patch_m 0 nan 1e-7
        numerics.antenna_block_m 0 nan
        world.preset "all"
        world.effects ["leak"]
        world.wall_bulge_m -1
        world.converter_bits 1 30
        disturbance.snr_db nan "high"
        disturbance.n_scatterers 0
        disturbance.n_channels 0
        """,
    ),
    bad("simulate spec.toml out", toml("spec.toml", "figure.name", '"yeti"'), says="yeti"),
    bad("simulate spec.toml out", toml("spec.toml", "figure.center_m", "[1,0,0]"), says="fit into"),
    bad("simulate spec.toml out", toml("spec.toml", "waveform.n_samples", "1048576"), says="GHz"),
    bad("simulate spec.toml out", put("spec.toml", "")),
    bad("simulate spec.toml out", put("spec.toml", "[figure\n")),
    bad("simulate spec.toml out", put("spec.toml", "[figure]\nmesh = 'no.ply'"), says="no.ply"),
    bad(
        "simulate spec.toml out",
        swap(
            "spec.toml",
            "[[walls]]\nsize_m = [0.16, 0.16, 0.16]",
            "[[walls]]\nsize_m = [0.12, 0.12, 0.12]\n[[walls]]\nsize_m = [0.16, 0.16, 0.16]",
        ),
        says="outermost first",
    ),
]
