"""Values of options: out of range, not a number, of the wrong type."""

from bad_inputs.lines import RUN
from bad_inputs.table import bad, sweep

HUGE = "9" * 400

ROWS = [
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
        refine.rim.dynamic-range-db 0 -1 nan
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
    *sweep("demo out {}", "seed -1\nthreads 0 x\nhybrid.fit.spacing-m 0"),
    bad("los 1e9x1e9x1e9 out", says="1e9"),
    bad("los 0x0.2x0.2 out", says="0x0.2"),
    bad("los -1x0.2x0.2 out", says="-1x"),
    *sweep(
        RUN + " {}",
        """
        fit.max-voxels 1e6 999 99999999999
        fit.position-power -1 1000 nan
        fit.normal-power nan -0.1
        fit.outside-weight -1 nan
        fit.outside-distance-m 0 nan -1
        fit.distance-band-m 0 nan
        fit.cap-start-m -1 nan
        fit.cap-slope -1 nan
        fit.absence-reach-m -1 nan
        fit.absence-angle-rad 0 4 nan
        fit.absence-depth-m inf
        glints.wall-margin-m nan inf
        glints.neighbor-offset-m 0 nan
        glints.neighbor-angle-rad 0 7 nan
        glints.cluster-link-m 0 inf
        glints.range-correction-m nan inf
        glints.noise-margin-db nan inf
        glints.subaperture.direction-oversampling 0 1e9 nan
        glints.subaperture.rim-sizes-m nan|0|5
        max-memory 0 -1 nan much
        calibrate yes 1
        preset hybrid bestt Glint
        """,
    ),
    *sweep(
        RUN + " --preset best {}",
        """
        refine.max-contradicted -1 2
        refine.rim-weight -1 inf
        refine.few-planes-voxel-scales 0 1e9
        refine.rim.dynamic-range-db 0 nan
        refine.silhouettes.max-tilt-deg 0 90
        refine.silhouettes.min-free 0 1 nan
        refine.fit.spacing-m 0 nan 1e-9
        heatmaps.withheld 0 0.9 nan
        heatmaps.rate-m 0 nan
        heatmaps.final-rate -1 2
        heatmaps.target-spacing-m 0 nan
        heatmaps.n-antennas 0
        """,
    ),
    *sweep(
        RUN + " --preset paper {}",
        """
        paper.lobe-power -1 nan
        paper.n-looks 0
        paper.n-clusters -1
        paper.bank 0 9
        paper.dark-scene 2 nan
        paper.charbonnier 0 nan
        paper.weight-decay -1 nan
        paper.reflectivity-n 1 100000
        paper.final-rate 2 -1
        paper.checkpoint-every 0
        paper.stage2.rsdf-weight -1 nan
        paper.field net
        paper.start middle
        """,
    ),
    *sweep(
        RUN + " --preset matched-filter {}",
        "matched-filter.spacing-m 0 1e-6 nan\nmatched-filter.threshold-scale 0 nan",
    ),
    *sweep(
        RUN + " --preset normal-field {}",
        "normal-field.spacing-m 0 nan\nnormal-field.level.n-levels 0\nnormal-field.weight-power -1",
    ),
    *sweep(
        RUN + " --preset back-projection {}",
        "back-projection.spacing-m 0 nan\nback-projection.dynamic-range-db 0 nan",
    ),
    *sweep(RUN + " --preset geraf1 {}", "level.reach-m 0 nan\nlevel.n-planes 0"),
    *sweep(
        "render run {}",
        """
        echo.wall-edge-m 0 1e-7 nan
        echo.stiffness 0 nan
        echo.n-planes 0
        n-draws -1 x
        spacing-m 5 -1
        threads 0 5000
        max-memory 1e-6
        """,
    ),
    *sweep("image scene out {}", "max-memory 1e-6\nspacing-m 2 5\nevery 0\nthreads 9999"),
    *sweep(
        "simulate spec.toml out {}", "max-memory 1e-6 0\nseed 99999999999999999999\nthreads 1e3"
    ),
    *sweep("import geraf-sens frames out {}", "phase-sign 0 x\nthreads 4097\nmax-memory"),
    *sweep(
        "los nerf out {}", "preset slow\ncamera-axes blender\nbounds 0 0 0 nan 1 1|\nhold-out x"
    ),
    *sweep("calibrate scene {}", "box 0 1 1|nan 1 1\ndelay-from ear\nautofocus.min-gain -1 nan"),
    *sweep("plan --depth 0.3 {}", "spacing 1e-9 20\naperture 0 0|11 1\nstandoff 1\nplanes 3"),
    *sweep("plan --box 11 1 1 {}", "box 0.2 0.2 -0.2|"),
    *sweep("evaluate run --truth truth.ply {}", "n-samples 1e4 10000001\nseed 1.5 nan"),
    *sweep("benchmark out --list {}", "jobs 5000\njobs 0.5"),
    *sweep("demo out {}", "glints.cluster-share 2\nseed x"),
]
