"""Specifications of simulations and suites of benchmarks."""

from bad_inputs.table import bad, keys, put, swap, toml

ROWS = [
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
    *keys(
        "simulate spec.toml out",
        "spec.toml",
        """
        figure.up "up"
        figure.turn_deg nan 1e9
        figure.roughness_length_m 0 nan
        figure.mesh "a.ply"
        waveform.chirp_slope_hz_per_s 0 70.15 nan
        waveform.sample_rate_hz 0 "fast"
        waveform.path_bias_m 1e9 nan
        scan.start_angle_deg nan inf
        scan.height_m nan 1e9
        scan.position_jitter_rms_m -1 1 nan
        scan.position_drift_rms_m 0.4
        scan.axis_offset_m [0]|[nan,0]|[100,0]
        scan.spacing_m 1e-5 11 "3mm"
        scan.colour "red"
        disturbance.scatterer_energy_fraction -1 nan inf
        disturbance.n_scatterers 1.5 100000000000
        disturbance.channel_phase_rms_deg -1 nan
        world.effects ["iq","iqq"]|"iq"|["iq"]
        world.leakage_db nan inf
        world.channel_gain_rms_db -1 nan
        world.ripple_rms -1 2
        world.roughness_rms_m 1.0
        world.patch_length_m 0
        world.pattern_exponent -1 1.5
        world.box_turn_deg 11 nan
        world.figure_permittivity 0.5 -1
        photos.n_photos 0 1000000000
        photos.size_px [4,4]|[1000000,1000000]|[640]
        photos.focal_length_px 0 nan
        photos.noise_rms -1 nan
        photos.exposure 0 inf
        photos.ring_elevations_deg []|[90]
        photos.subject "cat"
        """,
    ),
    bad("demo out --spec spec.toml", toml("spec.toml", "scan.n_poses", "0"), says="n_poses"),
    bad("demo out --spec spec.toml --max-memory 1e-6", says="--max-memory"),
    bad("benchmark out --suite suite.toml --list", put("suite.toml", "")),
    bad("benchmark out --suite suite.toml --list", put("suite.toml", "[scenes]\n[methods]\n")),
    bad("benchmark out --suite suite.toml --list", put("suite.toml", "scenes = 3")),
    bad("benchmark out --suite suite.toml --list", put("suite.toml", b"\xff")),
]
