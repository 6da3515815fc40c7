"""Second half of the table: what is to be simulated."""

from bad_inputs.table import bad, keys, put, toml

SPECS = [
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
