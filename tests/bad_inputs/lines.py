"""Command lines that read good inputs, and paths in a scene, which the rows share."""

RUN = "reconstruct scene out --box 0.16 0.16 0.16 --no-report --calibrate no --preset fast"
IMPORT = "import geraf-sens frames out"
UNPLACED = "import dca1000 raw/adc.bin out --radar radar.toml"
RAW = UNPLACED + " --raster 6 6 0.004 0.004"
SIGNAL, TX, RX = ("scene/radar.zarr/" + name for name in ("signal", "tx_positions", "rx_positions"))
