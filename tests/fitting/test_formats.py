"""Recordings as motion-capture software writes them: places, times and names come out right, or a cure is named."""

import sys

import numpy as np
import pytest

from jaxfem.fitting import FitError, Recording, read_recording, write_recording

Z = np.array([30.0, 29.9, 29.7])  # mm
TIMES = [0.0, 0.01, 0.02]
MOTIVE = (
    "Format Version,1.24,Take Name,t,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,Length Units,Meters,"
    "Coordinate Space,Global\n\n,Type,Rigid Body,Rigid Body Marker,Marker,Marker,Marker,Marker,Marker,Marker\n"
    ",Name,plate,plate:1,beam:tip,beam:tip,beam:tip,Unlabeled 1234,Unlabeled 1234,Unlabeled 1234\n,ID,0,1,2,2,2,3,3,3\n"
    ",Parent,,plate,beam,beam,beam,,,\n"
    ",,Rotation,Position,Position,Position,Position,Position,Position,Position\n"
    "Frame,Time (Seconds),X,X,X,Y,Z,X,Y,Z\n"
)
NEXUS = (
    "\n\nDevices\n1000\n,,Force\nFrame,Sub Frame,Fx\n,,N\n1,0,3\n1,1,3\n\nTrajectories\n100\n,,beam:tip,,,beam:mid,,\n"
)
NEXUS += "Frame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
TRC = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n100\t100\t3\t2\tcm\n"
    "Frame#\tTime\tmid\t\t\ttip\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n"
)
QUALISYS = "NO_OF_FRAMES\t3\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t1\nFREQUENCY\t100\nDATA_INCLUDED\t3D\nMARKER_NAMES\ttip\n"
ANIPOSE = "tip_x,tip_y,tip_z,tip_error,tip_ncams,tip_score,M_00,center_0,fnum\n"
LAB = "scorer,net,net,net,net,net,net\nbodyparts,tip,tip,tip,mid,mid,mid\ncoords,x,y,likelihood,x,y,likelihood\n"


def rows(form: str) -> str:
    """A line for each sample by a template of k, t and z."""
    return "".join(
        form.format(k=k, t=t, z=z, zm=z / 1e3, zc=z / 10) + "\n" for k, (t, z) in enumerate(zip(TIMES, Z, strict=True))
    )


FILES = {
    "motive": MOTIVE + rows("{k},{t},0.5,9,0.1,0.015,{zm},7,8,9"),
    "motive without labels": MOTIVE.replace(",Type,", ",,").replace(",Name,", ",,")
    + rows("{k},{t},1,9,.1,.015,{zm},,,"),
    "nexus": NEXUS
    + "101,0,100,15,30,50,15,30\n102,0,100,15,29.9,,,\n103,0,100,15,29.7,50,15,30\n\nModel Outputs\n100\n",
    "trc": TRC + rows("{k}\t{t}\t5\t1.5\t3\t10\t1.5\t{zc}"),
    "qualisys": QUALISYS + rows("100\t15\t{z}"),
    "qualisys, heading": QUALISYS
    + "TRAJECTORY_TYPES\tMeasured\nFrame\tTime\ttip X\ttip Y\ttip Z\n"
    + rows("{k}\t{t}\t100\t15\t{z}"),
    "semicolon, decimal comma": "time_s;tip_x_m;tip_y_m;tip_z_m\n" + rows("{t};0.1;0.015;{zm}").replace(".", ","),
    "tab": "time_s\ttip_x_m\ttip_y_m\ttip_z_m\n" + rows("{t}\t0.1\t0.015\t{zm}"),
    "bar": "time_s|tip_x_m|tip_y_m|tip_z_m\n" + rows("{t}|0.1|0.015|{zm}"),
    "blanks": "time_s tip_x_m tip_y_m tip_z_m\n" + rows("{t}  0.1  0.015 {zm}"),
    "quoted decimal comma": '"time_s","tip_x_m","tip_y_m","tip_z_m"\n' + rows('"{t}","0.1","0.015","{zm}"'),
    "units": "sep=,\ntime (ms),tip_x [mm],tip_y_cm,tip Z (mm)\n" + rows("{k}0,100,1.5,{z}"),
    "frames": "# a remark\nFrame,time_s,tip_x_mm,tip_y_mm,tip_z_mm,\n" + rows("{k},{t},100,15,{z},"),
    "index": ",time_s,tip_x_m,tip_y_m,tip_z_m\n" + rows("{k},{t},0.1,0.015,{zm}"),
    "repeated row": "time_s,tip_x_mm,tip_y_mm,tip_z_mm\n" + rows("{t},100,15,{z}") + "0.02,100,15,29.7\n",
}


def read(folder, text, encoding="utf-8", **asked) -> Recording:
    path = folder / "file.dat"  # the name tells nothing
    path.write_bytes(text.encode(encoding))
    return read_recording(path, **asked)


@pytest.mark.parametrize("name", FILES)
def test_places_and_times_come_out_right(tmp_path, name):
    found = read(tmp_path, FILES[name])
    tip = found.positions[:, found.names.index("tip")]
    np.testing.assert_allclose(tip, np.stack([0 * Z + 0.1, 0 * Z + 0.015, Z / 1e3], 1), rtol=1e-12)
    np.testing.assert_allclose(found.times, TIMES, atol=1e-12)
    assert found.source


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
@pytest.mark.parametrize("line", ["\n", "\r\n", "\r"])
def test_encodings_and_line_ends(tmp_path, encoding, line):
    text = "time_s;fuß_x_mm;fuß_y_mm;fuß_z_mm\n" + rows("{t};100;15;{z}")
    found = read(tmp_path, text.replace("\n", line), encoding)
    assert found.names == ("fuß",) and found.positions[2, 0, 2] == pytest.approx(0.0297)


def test_what_is_left_out_is_told(tmp_path):
    motive, nexus = read(tmp_path, FILES["motive"]), read(tmp_path, FILES["nexus"])
    assert motive.names == ("tip",) and "unlabelled" in str(motive.notes) and "Rigid Body Marker" in str(motive.notes)
    assert nexus.names == ("tip", "mid") and not nexus.seen[1, 1] and "frame 101" in str(nexus.notes)
    assert "Devices" in str(nexus.notes)
    lost = read(tmp_path, QUALISYS + "100\t15\t30\n0\t0\t0\n100\t15\t29.7\n")
    assert lost.seen[:, 0].tolist() == [True, False, True] and "0 0 0" in str(lost.notes)
    assert "counter" in str(read(tmp_path, FILES["frames"]).notes)
    assert len(read(tmp_path, FILES["repeated row"]).times) == 3


def test_a_nexus_gap_keeps_the_clock(tmp_path):
    text = NEXUS + "101,0,100,15,30,50,15,30\n102,0,100,15,30,50,15,30\n106,0,100,15,30,50,15,30\n"
    np.testing.assert_allclose(read(tmp_path, text).times, [0, 0.01, 0.05])


def test_anipose_needs_unit_and_rate(tmp_path):
    text = ANIPOSE + rows("100,15,{z},0.3,3,0.9,1,0,{k}")
    found = read(tmp_path, text, unit="mm", rate=100)
    np.testing.assert_allclose(found.positions[:, 0, 2], Z / 1e3)
    np.testing.assert_allclose(found.times, TIMES)
    with pytest.raises(FitError, match=r"Anipose.*calibration board"):
        read(tmp_path, text, rate=100)
    with pytest.raises(FitError, match=r"Anipose.*no rate.*rate=100"):
        read(tmp_path, text, unit="mm")


def test_deeplabcut_gives_pixels(tmp_path):
    camera = np.hstack([np.diag([800.0, 800.0, 1.0]), [[320.0], [240.0], [1.0]]])
    found = read(tmp_path, LAB + rows("{k},640.5,{z},0.99,1,2,0.2"), rate=100, camera=camera)
    assert found.unit == "px" and found.names == ("tip",) and "never seen, so left out: mid" in str(found.notes)
    np.testing.assert_allclose(found.positions[:, 0], np.stack([0 * Z + 640.5, Z, 0 * Z], 1))
    with pytest.raises(FitError, match=r"give its matrix \(3, 4\)"):
        read(tmp_path, LAB + rows("{k},640.5,{z},0.99,1,2,0.9"), rate=100, camera=np.eye(3))
    several = LAB.replace("bodyparts", "individuals,a,a,a,b,b,b\nbodyparts").replace("mid", "tip")
    assert read(tmp_path, several + rows("{k},1,2,0.9,3,4,0.9"), rate=50).names == ("a:tip", "b:tip")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MOTIVE.replace("Length Units,Meters,", "") + rows("{k},{t}"), "Motive.*unit of its places.*unit="),
        (MOTIVE.replace("Meters", "Furlongs") + rows("{k},{t}"), 'Motive.*"Furlongs" is no unit'),
        (
            MOTIVE.replace(",Marker", ",Rigid Body Marker") + rows("{k},{t}"),
            "Motive.*solved, not measured.*Markers ticked",
        ),
        (MOTIVE + "0,0,,,,,oops\n1,1\n", "Motive.*line 9, column \"beam:tip Z\": 'oops'"),
        ("Devices\n100\n,,F\nFrame,Sub Frame,Fx\n,,N\n1,0,3\n", "Nexus.*no section Trajectories"),
        ("Trajectories\n100\n,,a,,\nFrame,Sub Frame,X,Y\n,,mm,mm\n1,0,1,2\n2,0,1,2\n", "Nexus.*all components"),
        (NEXUS.replace("\n100\n", "\n\n"), "Nexus"),
        (TRC.replace("cm", "") + rows("{k}\t{t}\t5\t1.5\t3\t10\t1.5\t{zc}"), "TRC.*unit"),
        (TRC.replace("\tZ2", "") + rows("{k}\t{t}\t5\t1.5\t3\t10\t1.5"), 'TRC.*"tip" lacks the column Z2'),
        (QUALISYS.replace("3D", "6D").replace("MARKER_NAMES", "BODY_NAMES"), "Qualisys.*not 6D"),
        (QUALISYS.replace("\t100\n", "\t\n") + rows("1\t2\t{z}"), "Qualisys.*no rate"),
        (QUALISYS + rows("1\t2\t{z}\t4\t5\t6"), "Qualisys.*columns do not make"),
        ("frame,tip_x_m,tip_y_m,tip_z_m\n1,1,1,1\n2,1,1,1\n", "give their rate: rate=100"),
        ("time_s,tip_x,tip_y,tip_z\n1,1,1,1\n2,1,1,1\n", 'column "tip_x" says no unit'),
        ("time_s,tip_x_lb,tip_y_m,tip_z_m\n1,1,1,1\n2,1,1,1\n", '"lb" is no unit of length'),
        ("time_s,time_ms,tip_x_m,tip_y_m,tip_z_m\n1,1,1,1,1\n", "both times"),
        ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,1,0,2,0,3,0,4\n", "rows of samples"),
        ("time_s,tip_x_m,tip_y_m,tip_z_m\n" + "0,0,0,1,0,2,0,3\n" * 2, "decimal comma needs another separator"),
        ("\x89HDF\r\n", "HDF5.*export it as CSV"),
        ("PK\x03\x04", "workbook"),
        ("\x01\x02\x00\x03 nothing known", "none of the known formats"),
    ],
)
def test_errors_name_format_and_cure(tmp_path, text, message):
    with pytest.raises(FitError, match=message):
        read(tmp_path, text, "latin-1")


PLAIN = "time_s;tip_x_mm;tip_y_mm;tip_z_mm\n"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (FILES["tab"].encode("utf-16")[:-1], "UTF-16 and does not go on so.*cut off"),
        (FILES["tab"].encode("utf-16-le")[:-1], "cut off"),
        (b"\xef\xbb\xbf# gr\xfc\xdfe\n" + FILES["tab"].encode(), "several encodings"),
        ((PLAIN + "0;1,250;999.5;3\n1;1;2;3\n").encode(), "'1,250' in line 2.*'999.5' in line 2.*thousands"),
        ((PLAIN + "0,5;1.250;999,5;3\n1;1;2;3\n").encode(), "thousands"),
        ((PLAIN + "0;1.250,5;9;3\n1;1;2;3\n").encode(), "separators of thousands"),
        ((PLAIN + "s;mm;mm;mm\n0;1;2;3\n1;1;2;3\n").encode(), "take that row out.*units by the names"),
        (("A title\n" + PLAIN + "0;1;2;3\n1;1;2;3\n").encode(), "the first row names columns"),
        (b"\x1f\x8b\x08", "gzip.*unpack"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
        (b"<!DOCTYPE html><html>404</html>", "page of the web"),
        ((TRC.replace("100\t100", "x\t100") + "1\t\t5\t1\t3\t1\t1\t3\n" * 2).encode(), "TRC.*no rate"),
        ((QUALISYS.replace("\t100\n", "\tfast\n") + rows("1\t2\t{z}")).encode(), "Qualisys.*no rate"),
    ],
)
def test_damaged_and_foreign_files_are_named(tmp_path, data, message):
    (tmp_path / "file.dat").write_bytes(data)
    with pytest.raises(FitError, match=message):
        read_recording(tmp_path / "file.dat")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"rate": "100"}, "rate is '100'"),
        ({"rate": float("nan")}, "rate is nan"),
        ({"unit": 5}, "unit is 5"),
        ({"rate": 100, "camera": "none"}, "the camera is 'none'"),
        ({"rate": 100, "camera": [[1, 2], [3]]}, r"give its matrix \(3, 4\)"),
    ],
)
def test_what_is_said_of_a_file_is_checked(tmp_path, asked, message):
    with pytest.raises(FitError, match=message):
        read(tmp_path, LAB + rows("{k},640.5,{z},0.99,1,2,0.2"), **asked)


def test_a_rate_goes_with_the_times_or_is_refused(tmp_path):
    text = FILES["tab"]
    np.testing.assert_allclose(read(tmp_path, text, rate=100).times, TIMES, atol=1e-12)
    with pytest.raises(FitError, match=r"rate = 50 is given, and the times .* say 100 rows a second"):
        read(tmp_path, text, rate=50)
    counted = read(tmp_path, "time_s,tip_x_m,tip_y_m,tip_z_m\n" + rows("{k},0.1,0.015,0.03"), rate=100)
    np.testing.assert_allclose(counted.times, TIMES)
    assert "frame numbers" in str(counted.notes)


def test_what_a_file_says_otherwise_is_told(tmp_path):
    assert "taken for mm, as asked" in str(read(tmp_path, FILES["tab"], unit="mm").notes)
    assert "states 3 rows, and holds 2" in str(read(tmp_path, TRC + "1\t0\t5\t1\t3\t1\t1\t3\n2\t1\t" + "1\t" * 6).notes)
    unnamed = "time_s,,tip_x_m,tip_y_m,tip_z_m\n" + rows("{t},7,0.1,0.015,0.03")
    assert "column 2, which has no name" in str(read(tmp_path, unnamed).notes)
    assert len(read(tmp_path, FILES["tab"] + "\x1a").times) == 3


def test_a_frame_column_with_a_rate_is_a_clock(tmp_path):
    text = "frame,tip_x,tip_y,tip_z\n" + rows("{k},100,15,{z}")
    found = read(tmp_path, text, rate=100, unit="mm")
    np.testing.assert_allclose(found.times, TIMES)
    np.testing.assert_allclose(found.positions[:, 0, 2], Z / 1e3)


def test_c3d(tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["beam:tip", "beam:mid"]
    points = np.ones((4, 2, 3))
    points[:3] = np.array([[100.0, 50.0], [15.0, 15.0], [30.0, 30.0]])[..., None]
    points[2, 0] = Z
    file["data"]["points"] = points
    residuals = np.zeros((1, 2, 3))
    residuals[0, 1, 1] = -1
    file["data"]["meta_points"]["residuals"] = residuals
    file.write(str(tmp_path / "a.c3d"))
    found = read_recording(tmp_path / "a.c3d")
    np.testing.assert_allclose(found.positions[:, 0, 2], Z / 1e3, rtol=1e-6)
    assert found.names == ("tip", "mid") and found.seen[:, 1].tolist() == [True, False, True]
    np.testing.assert_allclose(found.times, TIMES)


def test_long_c3d_files_are_no_text(tmp_path):
    """Every other byte of one may be zero, as in UTF-16; one that was cut off is told by the count in its header."""
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"], file["parameters"]["POINT"]["UNITS"]["value"] = [100.0], ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["tip", "mid"]
    points = np.ones((4, 2, 200))
    points[:3] = 100 * np.random.default_rng(0).normal(size=(3, 2, 200))
    file["data"]["points"] = points
    file.write(str(tmp_path / "a.c3d"))
    found = read_recording(tmp_path / "a.c3d")
    np.testing.assert_allclose(found.positions, points[:3].transpose(2, 1, 0) / 1e3, rtol=1e-6)
    assert found.notes == ()
    (tmp_path / "a.c3d").write_bytes((tmp_path / "a.c3d").read_bytes()[:4000])
    assert "states 200 rows" in str(read_recording(tmp_path / "a.c3d").notes)


def test_c3d_without_its_reader_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(FitError, match=r"C3D.*pip install 'jaxfem\[c3d\]'"):
        read(tmp_path, "\x02\x50" + "\x00" * 1000, "latin-1")


def test_written_and_read_again(tmp_path):
    first = read(tmp_path, FILES["trc"])
    write_recording(tmp_path / "r.csv", first)
    np.testing.assert_allclose(read_recording(tmp_path / "r.csv").positions, first.positions, rtol=1e-8)
