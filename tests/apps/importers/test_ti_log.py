"""LogFile.txt of mmWave Studio and its scripts as configuration of a raw recording."""

import pytest

from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers._ti_config import read_ti_configs
from geraf2.apps.importers._ti_values import Transmitters
from geraf2.errors import UserError
from geraf2.io.manifest import RawManifest
from helpers.raw_capture import beat, opened, write_words

# Made by hand: codes of 77 GHz, 60.012 MHz/us, 6 us, 5 ns steps of 50 ms.
LOG = """25-Oct-2018 12:00:01: API:select_chip_version,AR1243,0,
25-Oct-2018 12:00:02: API:ChannelConfig,3,15,0,
25-Oct-2018 12:00:03: API:AdcOutConfig,2,1,0,
25-Oct-2018 12:00:04: API:LaneConfig,15,0,
25-Oct-2018 12:00:04: API:DataFmtConfig,15,2,1,0,0,0,
25-Oct-2018 12:00:05: API:ProfileConfig,0,1435384036,700,600,6000,0,0,900,0,32,5000,0,0,30,0,
25-Oct-2018 12:00:06: API:ProfileConfig,0,1435384036,700,600,6000,0,0,1243,0,64,1000,0,0,30,0,
25-Oct-2018 12:00:07: API:ChirpConfig,0,0,0,0,0,0,0,1,0,
25-Oct-2018 12:00:07: API:ChirpConfig,1,1,0,0,0,0,0,2,0,
25-Oct-2018 12:00:08: API:FrameConfig,0,1,20,1,10000000,0,0,1,
25-Oct-2018 12:00:09: some text, API of a sort
"""
SCRIPT = """-- ar1.ProfileConfig(0, 60, 9, 9, 9, 0, 0, 0, 0, 0, 0, 9, 0, 9, 9, 0, 0, 30)
ar1.ChanNAdcConfig(1, 1, 0, 1, 1, 1, 1, 2, 1, 0)
ar1.LVDSLaneConfig(0, 1, 1, 1, 1, 1, 0, 0)
ar1.ProfileConfig(0, 77, 7, 6, 60, 0, 0, 0, 0, 0, 0, 60.012, 0, 64, 1000, 0, 0, 30)
ar1.ChirpConfig(0, 0, 0, 0, 0, 0, 0, 1, 0, 0)
ar1.ChirpConfig(1, 1, 0, 0, 0, 0, 0, 0, 1, 0)
ar1.FrameConfig(0, 1, 20, 1, 50, 0, 0, 1)
"""


def read(tmp_path, text, name="LogFile.txt"):
    (tmp_path / name).write_text(text)
    return read_ti_configs([tmp_path / name])


@pytest.mark.parametrize(("text", "name"), [(LOG, "LogFile.txt"), (SCRIPT, "setup.lua")])
def test_calls_define_chirp_and_frame(tmp_path, text, name):
    config = read(tmp_path, text, name)
    # Half a step of the chip's frequency and slope.
    assert config.ramp_start_hz == pytest.approx(77e9, abs=30)
    assert config.chirp_slope_hz_per_s == pytest.approx(60.012e12, abs=0.025e12)
    assert config.adc_start_s == pytest.approx(6e-6)
    assert config.sample_rate_hz == 1e6
    assert config.frame_period_s == pytest.approx(0.05)
    assert (config.n_samples, config.n_rx, config.n_lanes) == (64, 4, 4)
    assert config.transmitters == Transmitters((1, 2), (0, 0))
    assert (config.n_chirps_per_frame, config.n_frames) == (2, 20)
    assert config.interleaved == (True if name == "LogFile.txt" else None)


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("FrameConfig,0,1,20,1,10000000,0,0,1,", "FrameConfig,0,1,", "line 10: FrameConfig has t"),
        ("FrameConfig,0,1", "FrameConfig,1,0", "chirpEndIdx of the frame lies before"),
        ("AdcOutConfig,2,1", "AdcOutConfig,2,3", "samples are neither real nor complex"),
        ("64,1000", "0x40,1e400", "line 7: 'ProfileConfig' must be a number, got '1e400'"),
    ],
)
def test_a_line_that_cannot_be_read_is_named(tmp_path, old, new, line):
    with pytest.raises(UserError, match=line):
        read(tmp_path, LOG.replace(old, new))


BRANCHES = {
    "a.lua": ("if chip == 1243 then\n  {a}\nelseif chip == 6843 then\n  {b}\nend\n", "--"),
    "b.lua": ("if (1243 == chip) then {a} else {b} end\n", "--"),
    "a.m": ("switch chip\n  case 1243\n    SendCommand('{a}');\n  otherwise\n {b}\nend\n", "%"),
    "a.js": ("if (chip === 1243) {{\n  {a};\n}} else {{\n  {b};\n}}\n", "//"),
    "a.py": ("if chip == 1243:\n    {a}\nelse:\n    {b}\n", "#"),
}
CALL = "ar1.ProfileConfig(0, {}, 7, 6, 60, 0, 0, 0, 0, 0, 0, 60, 0, 64, {}, 0, 0, 30)"


@pytest.mark.parametrize("name", BRANCHES)
def test_different_calls_in_branches_are_refused_with_both(tmp_path, name):
    form, comment = BRANCHES[name]
    both = {"a": CALL.format(77, 5000), "b": CALL.format(60.25, 10000)}
    with pytest.raises(UserError, match=r"expected 77, 5000, got 60\.25, 10000"):
        read(tmp_path, form.format(**both), name)
    same = read(tmp_path, form.format(a=both["a"], b=both["a"]), name)
    assert same.ramp_start_hz == 77e9
    # A comment is no call.
    text = f"{comment} {both['b']}\n" + form.format(a=both["a"], b=both["a"])
    assert read(tmp_path, text, name).ramp_start_hz == 77e9


def test_a_call_may_take_several_lines_and_comments_several_too(tmp_path):
    text = CALL.format(77, 5000).replace(", 60, 0,", ",\n    60,\n 0,", 1)
    text = f"--[[ {CALL.format(60, 1)}\n{CALL.format(60, 1)} ]]\n{text}"
    assert read(tmp_path, text, "a.lua").ramp_start_hz == 77e9


def test_the_profile_of_the_chirps_is_read(tmp_path):
    second = CALL.replace("(0,", "(1,").format(76, 2000)
    chirp = "ar1.ChirpConfig(0, 0, {}, 0, 0, 0, 0, 1, 0, 0)\nar1.FrameConfig(0, 0, 20, 1, 50, 0)\n"
    text = f"{CALL.format(77, 5000)}\n{second}\n"
    assert read(tmp_path, text + chirp.format(0), "a.lua").ramp_start_hz == 77e9
    assert read(tmp_path, text + chirp.format(1), "a.lua").ramp_start_hz == 76e9
    both = chirp.format(0) + "ar1.ChirpConfig(1, 1, 1, 0, 0, 0, 0, 1, 0, 0)\n"
    with pytest.raises(UserError, match="chirps of 2 profiles"):
        read(tmp_path, text + both, "a.lua")


PROFILE = "profileCfg 0 77 7 6 60 0 0 60 1 64 1000 0 0 30\n"


@pytest.mark.parametrize(
    ("name", "text", "reported"),
    [
        ("a.lua", CALL.format(77, 5000).replace("30)", "0, 0, 30)"), "too many values.*got 20"),
        ("a.cfg", "profileCfg" + " 1" * 16, "profileCfg has too many values.*got 16"),
        ("a.cfg", "chirpComnCfg 8 0 0 256 1 28 0\n", "low-power chip"),
        ("a.cfg", "advFrameCfg 2 0 0 1 0\n", "several sub-frames"),
        ("a.cfg", f"{PROFILE}frameCfg 0 3 64 5 656 100 1 0\n", "the fifth is no number of samples"),
        ("a.cfg", f"{PROFILE}lvdsStreamCfg -1 1 4 0\n", "more than samples"),
        (
            "a.setup.json",
            r'{"configUsed": "C:\\ti\\my.mmwave.json", "DCA1000Config": {"lvdsMode": 1}}',
            "my.mmwave.json, which it names",
        ),
        ("a.json", "{}", "is no configuration of a TI radar"),
    ],
)
def test_what_other_chips_and_files_hold_is_refused(tmp_path, name, text, reported):
    with pytest.raises(UserError, match=reported):
        read(tmp_path, text, name)


def studio_xml(chirp=(0, 0), loop=(0, 0), first_tx=1, **changed):
    """Settings as mmWave Studio saves them: in any order, decimal commas where Windows has them."""
    masks = {f"tx{first_tx + k}Enable": int(k == 0) for k in range(3)}
    sections = {
        "channel": {"rx3En": 1, "rx0En": 1, "tx0En": 1, "rx1En": 1, "rx2En": 0, "cascadeMode": 0},
        "lvdslane": {"lane4En": 0, "lane2En": 1, "lane3En": 0, "lane1En": 1, "laneFormat": 0},
        "adc": {"formatVal": 2, "bitsVal": 2, "IQSwap": 0},
        "profile": {
            "digOutSampleRate": 9121, "startFreqConst": "77.0", "freqSlopeConst": "63,343",
            "adcStartTimeConst": 6, "numAdcSamples": 512, "pprofileId": 0,
        },
        "chirp": {"chirpEndIdx": chirp[1], "chirpStartIdx": chirp[0], **masks},
        "frame": {
            "periodicity": 2, "loopCount": 16, "frameCount": 0,
            "fchirpStartIdx": loop[0], "fchirpEndIdx": loop[1],
        },
    }  # fmt: skip
    for name, values in changed.items():
        sections[name] |= values
    text = "".join(
        f"<apiname_{name}_cfg>"
        + "".join(f'<param name="{key}" value="{value}" />' for key, value in of.items())
        + f"</apiname_{name}_cfg>"
        for name, of in sections.items()
    )
    return f'<?xml version="1.0" encoding="utf-8" ?>\n<configuration>{text}</configuration>'


@pytest.mark.parametrize("first_tx", [0, 1])
def test_settings_of_mmwave_studio_are_read(tmp_path, first_tx):
    (tmp_path / "a.xml").write_text(studio_xml(first_tx=first_tx))
    found = read_ti_configs([tmp_path / "a.xml"])
    assert (found.n_samples, found.n_rx, found.n_lanes, found.is_real) == (512, 3, 2, False)
    assert found.first_sample_hz() == pytest.approx(77e9 + 6e-6 * 63.343e12)
    assert (found.sample_rate_hz, found.frame_period_s) == (9.121e6, 2e-3)
    assert (found.n_chirps_per_frame, found.n_frames) == (16, None)
    assert found.transmitters.masks == (1,)


def test_transmitters_that_the_settings_do_not_state_are_asked_for(tmp_path):
    write_words(tmp_path / "a.bin", beat(n_chirps=48, n_rx=3), "2-lane-sequential")
    (tmp_path / "a.xml").write_text(studio_xml((2, 2), (0, 2), profile={"numAdcSamples": 64}))
    options = ImportOptions(config=(tmp_path / "a.xml",))
    with pytest.raises(UserError, match="transmitters of the 3 chirps of a loop are not known"):
        opened(tmp_path / "a.bin", options)
    found = opened(tmp_path / "a.bin", options, raw=RawManifest(n_tx=3))
    assert (found.n_tx, found.n_frames, found.n_loops) == (3, 1, 16)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("</configuration>", "", "is not valid XML"),
        ("<configuration>", "<!DOCTYPE a [<!ENTITY b 'c'>]><configuration>", "declares entities"),
        ('name="numAdcSamples"', 'name="n"', "parameter 'profile.numAdcSamples' is missing"),
        ('value="9121"', 'value="many"', "'profile.digOutSampleRate' must be a number"),
    ],
)
def test_broken_settings_are_refused(tmp_path, old, new, text):
    (tmp_path / "a.xml").write_text(studio_xml().replace(old, new))
    with pytest.raises(UserError, match=text):
        read_ti_configs([tmp_path / "a.xml"])
