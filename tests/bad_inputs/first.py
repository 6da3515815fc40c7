"""First half of the table, written before anything was mended."""

from bad_inputs.first_specs import SPECS
from bad_inputs.table import (
    bad,
    cut,
    drop,
    flip,
    folder,
    keys,
    link,
    npy,
    npz,
    numbers,
    put,
    set_at,
    swap,
    sweep,
    toml,
    values,
)

RUN = "reconstruct scene out --box 0.16 0.16 0.16 --no-report --calibrate no --preset fast"
IMPORT = "import geraf-sens frames out"
RAW = "import dca1000 raw/adc.bin out --radar radar.toml --raster 6 6 0.004 0.004"
PLACES = "import dca1000 raw/adc.bin out --radar radar.toml"
SIGNAL, TX, RX = ("scene/radar.zarr/" + name for name in ("signal", "tx_positions", "rx_positions"))
HUGE = "9" * 400

WORDS = [
    bad("nothing", says="unknown command"),
    bad("reconstrukt scene out", says="reconstruct"),
    bad("reconstruct", says="SCENE"),
    bad("reconstruct scene", says="OUT"),
    bad("reconstruct scene out", says="--box"),
    bad("reconstruct scene out --box 0.16 0.16 0.16 --los box.ply", says="both"),
    bad("reconstruct scene out extra --box 0.16 0.16 0.16", says="extra"),
    bad(RUN + " --nonsense 3", says="--nonsense"),
    bad(RUN + " --preset fats", says="fast"),
    bad(RUN + " --preset", says="preset"),
    bad(RUN + " --calibrate maybe", says="--calibrate"),
    bad("import", says="FORMAT"),
    bad("import nothing frames out", says="geraf-sens"),
    bad("import geraf-sens nowhere out", says="nowhere"),
    bad("import geraf-sens box.ply out", says="box.ply"),
    bad("import geraf-sens empty out", says="empty"),
    bad("import mat empty out", says="empty"),
    bad("import mat nowhere out", says="nowhere"),
    bad("import planar empty out", says="empty"),
    bad("import planar nowhere out", says="nowhere"),
    bad("import mmnorm empty out", says="empty"),
    bad("import dca1000 empty out", says="empty"),
    bad("import dca1000 nowhere out", says="nowhere"),
    bad("import geraf-sens frames other", says="other"),
    bad("import geraf-sens frames box.ply", says="box.ply"),
    bad("import geraf-sens frames scene", says="scene"),
    bad("info", says="SCENE"),
    bad("info nowhere", says="nowhere"),
    bad("info other", says="other"),
    bad("info box.ply", says="box.ply"),
    bad("info scene --figure", says="--figure"),
    bad("image scene", says="OUT"),
    bad("image nowhere out", says="nowhere"),
    bad("image scene other --every 4 --spacing-m 0.02", says="other"),
    bad("image scene box.ply --every 4 --spacing-m 0.02", says="box.ply"),
    bad("simulate", says="SPEC"),
    bad("simulate nowhere.toml out", says="nowhere.toml"),
    bad("simulate scene out", says="scene"),
    bad("simulate box.ply out", says="box.ply"),
    bad("simulate spec.toml other", says="other"),
    bad("calibrate", says="SCENE"),
    bad("calibrate nowhere", says="nowhere"),
    bad("calibrate scene", says="box"),
    bad("calibrate scene out --write --box 0.16 0.16 0.16", says="--write"),
    bad("calibrate scene --box 0.16 0.16 0.16 --delay-from reflector", says="--reflector"),
    bad("los", says="OUT"),
    bad("los nowhere out", says="nowhere"),
    bad("los empty out", says="empty"),
    bad("los box.ply other", says="other"),
    bad("los spec.toml out", says="spec.toml"),
    bad("render nowhere", says="nowhere"),
    bad("render other", says="other"),
    bad("render scene", says="scene"),
    bad("render run --scene nowhere", says="nowhere"),
    bad("render run --angles 12.5", says="12.5"),
    bad("evaluate run", says="--truth"),
    bad("evaluate nowhere --truth truth.ply", says="nowhere"),
    bad("evaluate run --truth nowhere.ply", says="nowhere.ply"),
    bad("evaluate run --truth scene", says="scene"),
    bad("evaluate run --truth spec.toml", says="spec.toml"),
    bad("evaluate scene --truth truth.ply", says="scene"),
    bad("plan", says="--box"),
    bad("plan --box 0.2 0.2", says="--box"),
    bad("plan --box 0.2 0.2 0.2 --depth 0.3", says="--box"),
    bad("plan --box 0.2 0.2 0.2 --standoff 0.1", says="--standoff"),
    bad("plan --box 0.2 0.2 0.2 --radar radar.toml --preset awr1843", says="both"),
    bad("plan --box 0.2 0.2 0.2 --radar radar.toml", says="n_samples"),
    bad("plan --box 0.2 0.2 0.2 --figure plan.docx", says="plan.docx"),
    bad("plan --box 0.2 0.2 0.2 --figure nowhere/plan.png", says="nowhere"),
    bad("benchmark other", says="other"),
    bad("benchmark out --only nothing --list", says="nothing"),
    bad("benchmark out --suite nowhere.toml --list", says="nowhere.toml"),
    bad("benchmark out --suite box.ply --list", says="box.ply"),
    bad("demo other", says="other"),
    bad("demo box.ply", says="box.ply"),
    bad("demo out --spec nowhere.toml", says="nowhere.toml"),
    bad("doctor extra", says="extra"),
]

FLAGS = [
    *sweep(
        RUN + " {}",
        f"""
        threads 0 -3 two 1.5 99999999
        seed -1 0.5 many {HUGE}
        hold-out nan inf
        glints.neighbor-count -1 -2
        glints.neighbor-radius-m 0 -1 nan inf
        glints.cluster-share 2 -0.1 nan
        glints.dynamic-range-db -1 nan
        glints.subaperture.size-m 0 -0.1 nan inf
        glints.subaperture.step-m 0 nan 1e-9
        glints.subaperture.max-cosine 0 2 nan
        glints.subaperture.range-oversampling 0 -1 100000
        fit.max-voxels 0 -5 none
        fit.strong-quantile 2 -0.1 nan
        fit.spacing-m 0 -1 nan inf 1e-9 10
        fit.coarse-spacing-m 0 -1 nan 1e-9
        fit.margin-m -1 nan inf
        fit.distance-rounds -1 1000000
        fit.position-weight -1 nan inf
        fit.bending-weight 0 -1 nan
        fit.cap-lean nan nan|-9 -9
        """,
    ),
    *sweep(
        RUN + " --preset best {}",
        """
        refine.links.chord-m 0 -1 nan
        refine.rim.rounds -1
        refine.rim.sizes-m 0|nan|-0.05
        refine.silhouettes.spacing-m 0 nan 1e-9
        heatmaps.n-rounds -1
        heatmaps.n-steps 0 -1
        heatmaps.parts 0 -1
        heatmaps.max-edge-m 0 nan 1e-9
        """,
    ),
    *sweep(
        RUN + " --preset paper {}",
        """
        paper.n-samples 0 -1 1000000000
        paper.n-antennas 0 -1
        paper.grid-n 0 25|-3
        paper.mesh-n 0 1 100000
        paper.window-m -1 nan
        paper.start-radius 0 nan -1
        paper.inv-s-start 0 nan
        paper.stage1.n-steps -1
        paper.grid-rate -1 nan
        """,
    ),
    *sweep(
        "image scene out --every 4 {}",
        """
        spacing-m 0 -1 nan inf 1e-7
        every 0 -1 1.5
        pose -1 99 x
        size-m 0 0 0|nan 1 1|1e9 1e9 1e9
        center-m nan 0 0|inf 0 0
        depth-m 0.3 0.2|nan 1|-1 -0.5
        angles-deg 60 0|-5 10|0 95|nan 10
        """,
    ),
    *sweep(
        "plan --box 0.2 0.2 0.2 {}",
        """
        planes 0 -1 1000000000
        spacing 0 -1 nan 1e-12
        standoff 0 nan inf 1e9
        aperture 0 0.1|nan 1
        elevations-deg 90|nan|-95
        frame-period-s 0 -1 nan
        speed-m-per-s 0 inf
        """,
    ),
    *sweep(
        "evaluate run --truth truth.ply {}",
        """
        n-samples 0 -1 1000000000000
        seed -1 x
        threads 0
        """,
    ),
    *sweep(
        "render run {}",
        """
        spacing-m 0 nan 1e-7
        n-draws 0
        seed -1
        angles nan
        echo.max-edge-m 0 -1 nan 1e-7
        echo.n-nodes 0 -1
        echo.n-targets 0
        """,
    ),
    *sweep(
        "calibrate scene --box 0.16 0.16 0.16 {}",
        """
        channels 1 0 -2 x
        delay-search 0.1 0|nan 1|-100 100
        reflector nan 0 0|
        autofocus.n-coefficients 0 -1
        autofocus.sigma-m 0 nan
        """,
    ),
    *sweep("simulate spec.toml out {}", "seed -1 x\nthreads 0"),
    *sweep("los 0.2x0.2x0.2 out {}", "box-center nan 0 0|inf 0 0\nbounds 1 1 1 0 0 0|\nthreads -1"),
    *sweep("benchmark out --list {}", "jobs 0 -1 x\nseed -1\nthreads 0"),
    *sweep("demo out {}", "seed -1\nthreads 0 x\nrefine.fit.spacing-m 0"),
    bad("los 1e9x1e9x1e9 out", says="1e9"),
    bad("los 0x0.2x0.2 out", says="0x0.2"),
    bad("los -1x0.2x0.2 out", says="-1x"),
]

SCENES = [
    *keys(
        "info scene",
        "scene/scene.toml",
        """
        version 2 "one" -1
        unit "mm" 3
        format "other"
        frame "" 7
        typo 3
        waveform.start_frequency_hz 77 0 nan "77e9"
        waveform.chirp_slope_hz_per_s -1 70.15 inf
        waveform.n_samples 0 31 32.5 1000000000
        waveform.sample_rate_hz 0 nan
        waveform.path_bias_m 1e6 nan
        walls.permittivity 0.5 nan -1
        walls.thickness_m 0 -1 nan
        walls.size_m [0.16,0.16]|[0,0.16,0.16]|"big"
        """,
    ),
    bad("info scene", put("scene/scene.toml", "")),
    bad("info scene", put("scene/scene.toml", b"\xff\xfe\x00")),
    bad("info scene", put("scene/scene.toml", "a = [" * 2000)),
    bad("info scene", cut("scene/scene.toml")),
    bad("info scene", drop("scene/scene.toml")),
    bad("info scene", folder("scene/scene.toml")),
    bad("info scene", drop("scene/radar.zarr")),
    bad("info scene", drop("scene/radar.zarr/zarr.json"), says="radar.zarr"),
    bad("info scene", put("scene/radar.zarr/zarr.json", "{}"), says="radar.zarr"),
    bad("info scene", values("scene/radar.zarr/zarr.json", zarr_format=9), says="radar.zarr"),
    bad("info scene", drop(SIGNAL)),
    bad("info scene", drop(f"{TX}/zarr.json"), says="tx_positions"),
    bad("info scene", put(f"{SIGNAL}/zarr.json", "[]"), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", shape=[4, -1, 32]), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", shape=[4, 256]), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", shape=[4, 1 << 40, 32]), says="radar.zarr"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", data_type="float64"), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", data_type="nonsense"), says="signal"),
    bad("info scene", values(f"{TX}/zarr.json", data_type="complex128"), says="tx_positions"),
    bad("info scene", values(f"{TX}/zarr.json", data_type="bool"), says="tx_positions"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", codecs=[]), says="signal"),
    bad(
        "info scene",
        values(f"{SIGNAL}/zarr.json", codecs=[{"name": "zstd", "configuration": {}}]),
        says="signal",
    ),
    bad("info scene", cut(f"{SIGNAL}/c/0/0/0"), says="signal"),
    bad("info scene", cut(f"{TX}/c/0/0/0"), says="tx_positions"),
    bad("info scene", flip(f"{SIGNAL}/c/1/0/0", 1000), says="signal"),
    bad("info scene --verify", flip(f"{RX}/c/1/0/0", 1001), says="rx_positions"),
    *(
        bad(f"{line}", numbers(f"{SIGNAL}/c/0/0/0", "<f4", "NaN", set_at((5, "nan"))), says="NaN")
        for line in ("info scene", RUN, "image scene out --every 4 --spacing-m 0.02")
    ),
    bad(RUN, numbers(f"{TX}/c/0/0/0", "<f8", "NaN", set_at((0, "nan"))), says="NaN"),
    bad(RUN, numbers(f"{TX}/c/0/0/0", "<f8", "1e30", set_at((0, 1e30))), says="1e+30"),
    bad("info scene", numbers(f"{TX}/c/0/0/0", "<f8", "1e30", set_at((0, 1e30))), says="1e+30"),
    bad(
        RUN, numbers("scene/radar.zarr/axes/c/0/0/0", "<f8", "NaN", set_at((0, "nan"))), says="axes"
    ),
    bad(RUN, numbers("scene/radar.zarr/axes/c/0/0/0", "<f8", "0", lambda a: 0 * a), says="axes"),
    bad(RUN, numbers("scene/radar.zarr/axes/c/0/0/0", "<f8", "x 2", lambda a: 2 * a), says="axes"),
    *(
        bad(line, numbers(f"{TX}/c/2/0/0", "<f8", "in mm", lambda a: 1000 * a), says=says)
        for line, says in ((RUN, "transmitter"), ("info scene", "transmitter"))
    ),
    bad(
        RUN,
        *(numbers(f"{p}/c/2/0/0", "<f8", "in mm", lambda a: 1000 * a) for p in (TX, RX)),
        says="metres",
    ),
    bad(
        RUN,
        numbers("scene/radar.zarr/antenna_count/c/0", "<i8", "-1", set_at((0, -1))),
        says="antenna_count",
    ),
    bad(
        RUN,
        numbers("scene/radar.zarr/antenna_count/c/0", "<i8", "big", set_at((0, 9999))),
        says="antenna_count",
    ),
    bad(
        RUN,
        numbers("scene/radar.zarr/antenna_count/c/0", "<i8", "0", set_at((0, 0))),
        says="0 antennas",
    ),
    bad(RUN + " --hold-out 17.5", says="17.5"),
    bad(RUN + " --fit.cap-lean 1 2 3", says="'3'"),
]

PRIORS = [
    bad("reconstruct scene out --box 0.16 0.16 --no-report", says="--box"),
    bad("reconstruct scene out --box 0 0.16 0.16", says="box"),
    bad("reconstruct scene out --box nan 0.16 0.16", says="box"),
    bad("reconstruct scene out --box 160 160 160", says="metres"),
    bad("reconstruct scene out --box 0.0001 0.0001 0.0001", says="box"),
    bad("reconstruct scene out --box 0.9 0.9 0.9", says="box"),
    bad("reconstruct scene out --box 0.16 0.16 0.16 --box-center 5 0 0", says="box"),
    bad("reconstruct scene out --box 0.16 0.16 0.16 --box-center nan 0 0", says="box"),
    bad("reconstruct scene out --los nowhere", says="nowhere"),
    bad("reconstruct scene out --los empty", says="empty"),
    bad("reconstruct scene out --los scene", says="scene"),
    bad("reconstruct scene out --los spec.toml", says="spec.toml"),
    *(
        bad(line, change)
        for line in ("los box.ply out", "reconstruct scene out --los box.ply")
        for change in (
            put("box.ply", ""),
            put("box.ply", "ply\n"),
            put("box.ply", "no mesh"),
            cut("box.ply"),
            cut("box.ply", 0.95),
            swap("box.ply", "element vertex 8", "element vertex 9999999"),
            swap("box.ply", "element face 12", "element face 13"),
            swap("box.ply", "property float x", "property list x y"),
            folder("box.ply"),
        )
    ),
    bad(
        "los flat.stl out",
        put(
            "flat.stl",
            "solid a\nfacet normal 0 0 1\nouter loop\n"
            "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
        ),
    ),
    bad(
        "los far.obj out",
        put(
            "far.obj",
            "v 1e30 0 0\nv 0 1e30 0\nv 0 0 1e30\nv 0 0 0\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n",
        ),
    ),
    bad("los nan.obj out", put("nan.obj", "v nan 0 0\nv 0 1 0\nv 0 0 1\nv 0 0 0\nf 1 2 3\n")),
    bad("los dots.obj out", put("dots.obj", "v 0 0 0\nv 0 1 0\n")),
    bad(
        "los big.stl out",
        put(
            "big.stl",
            "solid a\n"
            + "".join(
                f"facet normal 0 0 1\nouter loop\n{''.join(f'vertex {p}' + chr(10) for p in face)}"
                "endloop\nendfacet\n"
                for face in (
                    ("0 0 0", "220 0 0", "0 220 0"),
                    ("0 0 0", "0 220 0", "0 0 220"),
                    ("0 0 0", "0 0 220", "220 0 0"),
                    ("220 0 0", "0 0 220", "0 220 0"),
                )
            )
            + "endsolid\n",
        ),
        says="millimetres",
    ),
    bad("evaluate run --truth box.ply", values("box.ply.json", unit="millimetre"), says="unit"),
    bad("los box.ply out", values("box.ply.json", unit="millimetre"), says="unit"),
    bad("los box.ply out --unit parsec", says="--unit"),
    bad("los box.ply out --unit -1", says="--unit"),
    bad("los box.ply out --to-radar nowhere.txt", says="nowhere.txt"),
    bad("los box.ply out --to-radar m.txt", put("m.txt", "1 2 3")),
    bad("los box.ply out --to-radar m.txt", put("m.txt", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1")),
    bad("los box.ply out --to-radar m.txt", put("m.txt", "nan 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1")),
]

FRAME = "frames/mf/1_120_0"
IMPORTS = [
    *(bad(IMPORT, drop(f"{FRAME}/{name}.npy")) for name in ("tpos", "adcr", "rotation")),
    *(bad(IMPORT, put(f"{FRAME}/{name}.npy", b"")) for name in ("rpos", "adci")),
    *(bad(IMPORT, cut(f"{FRAME}/{name}.npy")) for name in ("tpos", "adcr", "rotation")),
    bad(IMPORT, npy(f"{FRAME}/tpos.npy", "in mm", lambda a: 1000 * a), says="transmitter"),
    bad(
        IMPORT,
        *(npy(f"{FRAME}/{n}.npy", "in mm", lambda a: 1000 * a) for n in ("tpos", "rpos")),
        says="metres",
    ),
    bad(IMPORT, npy(f"{FRAME}/rotation.npy", "x 2", lambda a: 2 * a)),
    bad(IMPORT, npy(f"{FRAME}/rotation.npy", "0", lambda a: 0 * a)),
    bad(IMPORT, npy(f"{FRAME}/rotation.npy", "NaN", lambda a: a * np_nan())),
    bad(IMPORT, npy(f"{FRAME}/adcr.npy", "one short", lambda a: a[:-1])),
    bad(IMPORT, npy(f"{FRAME}/adcr.npy", "integers", lambda a: a.astype("i4"))),
    bad(IMPORT, npy(f"{FRAME}/rpos.npy", "NaN", set_at((3, "nan")))),
    bad(IMPORT, npy(f"{FRAME}/rpos.npy", "1e30", set_at((3, 1e30))), says="1e+30"),
    bad(IMPORT, link(FRAME, "nowhere"), says="1_120_0"),
    bad(IMPORT, link(FRAME, "1_120_0"), says="1_120_0"),
    bad(IMPORT, put("frames/capture.json", "[]")),
    bad(IMPORT, put("frames/capture.json", "{")),
    bad(IMPORT, put("frames/capture.json", b"\xff")),
    bad(IMPORT, put("frames/capture.json", "[" * 100000)),
    bad(
        IMPORT, values("frames/capture.json", path_bais_m=0.15, path_bias_m=...), says="path_bais_m"
    ),
    bad(IMPORT, values("frames/capture.json", box_size=0.22), says="box_size"),
    bad(IMPORT, values("frames/capture.json", start_frequency_hz=77.0), says="start_frequency_hz"),
    bad(IMPORT, values("frames/capture.json", start_frequency_hz="77e9"), says="frequency"),
    bad(IMPORT, values("frames/capture.json", chirp_slope_hz_per_s=-7e13), says="slope"),
    bad(IMPORT, values("frames/capture.json", adc_sample_rate_hz=...), says="sample_rate"),
    bad(IMPORT, values("frames/capture.json", n_adc_samples=31), says="n_samples"),
    bad(IMPORT, values("frames/capture.json", path_bias_m=1e9), says="path_bias_m"),
    bad(IMPORT, values("frames/capture.json", wall_permittivity=0.1), says="permittivity"),
    bad(
        IMPORT,
        values(
            "frames/capture.json",
            box_size_m=[0.2, 0.3],
            wall_thickness_m=[0.004] * 2,
            wall_permittivity=[1.6, 1.6],
        ),
        says="outermost first",
    ),
    bad(IMPORT + " --phase-sign 2", says="--phase-sign"),
    bad(IMPORT + " --threads 0", says="--threads"),
    bad(IMPORT + " --radar nowhere.toml", says="nowhere.toml"),
    bad(
        IMPORT + " --radar radar.toml", toml("radar.toml", "path_bais_m", "0.1"), says="path_bais_m"
    ),
    *keys(
        RAW,
        "radar.toml",
        """
        start_frequency_hz 77 -1 nan
        chirp_slope_hz_per_s 60 inf
        sample_rate_hz 0 "fast"
        adc_start_s -1 nan 2
        n_samples 0 63 9999999
        raw.n_rx 0 100
        raw.layout "other"
        raw.frame_period_s 0 -1
        antennas.rx_offsets_m []|[[1,2]]|[[0,0,nan]]
        """,
    ),
    bad(RAW, toml("radar.toml", "raw.n_rx", "3"), says="receivers"),
    bad(RAW, put("raw/adc.bin", b"")),
    bad(RAW, put("raw/adc.bin", bytes(7))),
    bad(RAW, put("raw/adc.bin", bytes(40000))),
    bad(RAW, cut("raw/adc.bin", 0.97)),
    bad(RAW, cut("raw/adc.bin", 0.5)),
    bad("import dca1000 raw/adc.bin out --radar radar.toml", says="--raster"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --raster 0 6 1 1", says="--raster"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --raster 6 6 nan 1", says="--raster"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --raster 5 5 0.004 0.004", says="36"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --serpentine", says="--raster"),
    bad(PLACES + " --positions nowhere.csv", says="nowhere.csv"),
    *(
        bad(PLACES + " --positions robot.csv", change)
        for change in (
            put("robot.csv", ""),
            put("robot.csv", "time_s,x_m,y_m,z_m\n"),
            put("robot.csv", b"\x00\xff"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m\n0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n1,0,0,0\n0,0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n0,nan,0,0\n1,0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n0,a,0,0\n1,0,0,0\n"),
        )
    ),
    bad("import mat scan.mat out", put("scan.mat", b"")),
    bad("import mat scan.mat out", put("scan.mat", b"MATLAB" * 40)),
    bad("import mat scan.mat out", cut("scan.mat")),
    bad("import mat scan.mat out", cut("scan.mat", 0.999)),
    bad("import mat scan.mat out", flip("scan.mat", 128)),
    bad("import mat scan.mat out", flip("scan.mat", 144)),
    bad("import mmnorm norm.npz out", cut("norm.npz")),
    bad("import mmnorm norm.npz out", put("norm.npz", b"PK\x03\x04" + bytes(50))),
    bad("import mmnorm norm.npz out", npz("norm.npz", "no signals", received_signals=None)),
    bad("import mmnorm norm.npz out", npz("norm.npz", "NaN", antenna_locations=set_at((0, "nan")))),
    bad(
        "import mmnorm norm.npz out",
        npz("norm.npz", "in mm", antenna_locations=lambda a: 1000 * a),
        says="metres",
    ),
    bad("import planar planar out", cut("planar/scan.npy"), says="scan.npy"),
    bad("import planar planar out", put("planar/scan.npy", b""), says="scan.npy"),
    bad("import planar planar out", put("planar/antenna_phase.txt", "a b"), says="antenna_phase"),
    bad("import planar planar out", flip("planar/scan.npy", 20), says="scan.npy"),
]

PHOTOS = [
    *(
        bad(f"los {name} out --preset quick", change, says=says)
        for name, change, says in (
            ("nerf", put("nerf/transforms.json", "{}"), "transforms.json"),
            ("nerf", put("nerf/transforms.json", "[" * 100000), "transforms.json"),
            ("nerf", values("nerf/transforms.json", frames=[]), "transforms.json"),
            ("nerf", values("nerf/transforms.json", fl_x=0), "focal"),
            ("nerf", values("nerf/transforms.json", fl_x="wide"), "fl_x"),
            ("nerf", values("nerf/transforms.json", w=-4), "transforms.json"),
            ("nerf", swap("nerf/transforms.json", "[[", "[[1e400,"), "transforms.json"),
            ("colmap", cut("colmap/sparse/0/images.bin"), "images.bin"),
            ("colmap", put("colmap/sparse/0/cameras.bin", b""), "cameras.bin"),
            ("colmap", put("colmap/sparse/0/images.bin", b"\xff" * 64), "images.bin"),
            ("colmap", drop("colmap/sparse/0/cameras.bin"), "cameras"),
            ("colmap_text", put("colmap_text/sparse/0/images.txt", "1 2 3"), "images.txt"),
            ("colmap_text", swap("colmap_text/sparse/0/cameras.txt", "OPENCV", "X"), "cameras.txt"),
            ("colmap_text", swap("colmap_text/sparse/0/cameras.txt", "64", "-6"), "cameras.txt"),
            ("neus", cut("neus/cameras_sphere.npz"), "cameras_sphere.npz"),
            (
                "neus",
                npz("neus/cameras_sphere.npz", "NaN", world_mat_0=lambda a: a * float("nan")),
                "world_mat_0",
            ),
            (
                "neus",
                npz("neus/cameras_sphere.npz", "flat", world_mat_0=lambda a: a[:3, :3]),
                "world_mat_0",
            ),
            ("llff", npy("llff/poses_bounds.npy", "16 columns", lambda a: a[:, :16]), "bounds.npy"),
            ("llff", npy("llff/poses_bounds.npy", "NaN", lambda a: a * float("nan")), "bounds.npy"),
            ("ring", swap("ring/ring_par.txt", "6\n", "7\n"), "ring_par.txt"),
            ("ring", put("ring/ring_par.txt", "1\nphoto0.png 1 2"), "ring_par.txt"),
        )
    ),
    *sweep("los nerf out {}", "hold-out -1 1\nmask-threshold -1 255 nan\nseed -1\nmasks nowhere"),
]

RUNS = [
    bad("render run", drop("run/run.json"), says="run"),
    bad("render run", put("run/run.json", "{")),
    bad("render run", put("run/run.json", "[]")),
    bad("render run", values("run/run.json", version=99), says="99"),
    bad("render run", values("run/run.json", stages=3)),
    bad("render run", drop("run/config.toml")),
    bad("render run", put("run/config.toml", "preset = 'other'")),
    bad("render run", toml("run/config.toml", "fit.max_voxels", "-1"), says="max_voxels"),
    bad("render run", cut("run/prior.npz"), says="prior.npz"),
    bad("evaluate run --truth truth.ply", cut("run/mesh_content.ply"), says="mesh_content.ply"),
    bad("evaluate run --truth truth.ply", drop("run/mesh_content.ply"), says="mesh_content.ply"),
    bad("evaluate run --truth truth.ply", put("run/run.json", b"\x00"), says="run.json"),
    bad("evaluate run --truth truth.ply", cut("truth.ply")),
    bad("evaluate run --truth truth.ply", put("truth.ply", "")),
    *(
        bad("reconstruct scene out --config run/config.toml", change)
        for change in (
            toml("run/config.toml", "fit.spacing_m", "nan"),
            toml("run/config.toml", "fit.spacing_m", "'4 mm'"),
            toml("run/config.toml", "fit.strong_quantile", "2.0"),
            toml("run/config.toml", "fit.unknown", "1"),
            toml("run/config.toml", "glints.cluster_share", "2.0"),
            toml("run/config.toml", "glints.subaperture.step_m", "0.0"),
            put("run/config.toml", "preset = 3"),
            put("run/config.toml", ""),
            swap("run/config.toml", 'preset = "fast"', "preset = fast"),
        )
    ),
]


def np_nan():
    return float("nan")


ROWS = [*WORDS, *FLAGS, *SCENES, *PRIORS, *IMPORTS, *PHOTOS, *RUNS, *SPECS]
