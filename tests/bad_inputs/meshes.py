"""Boxes and meshes: sizes, broken mesh files, units and transforms."""

import struct

from bad_inputs.table import bad, cut, put, swap, values

CUBE = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
GLB = struct.pack("<4sII", b"glTF", 2, 9999) + struct.pack("<I4s", 8, b"JSON") + b"{}      "

ROWS = [
    bad("reconstruct scene out --box 160 160 160", text="metres"),
    bad("reconstruct scene out --box 0.9 0.9 0.9", text="box"),
    bad("reconstruct scene out --box 0.16 0.16 0.16 --box-center 5 0 0", text="box"),
    bad("reconstruct scene out --los nowhere", text="nowhere"),
    bad("reconstruct scene out --los empty", text="empty"),
    bad("reconstruct scene out --los spec.toml", text="spec.toml"),
    *(
        bad(line, change)
        for line in ("los box.ply out", "reconstruct scene out --los box.ply")
        for change in (
            put("box.ply", ""),
            put("box.ply", "ply\n"),
            cut("box.ply", 0.95),
            swap("box.ply", "element vertex 8", "element vertex 9999999"),
            swap("box.ply", "property float x", "property list x y"),
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
        text="millimetres",
    ),
    bad("evaluate run --truth box.ply", values("box.ply.json", unit="millimetre"), text="unit"),
    bad("los box.ply out", values("box.ply.json", unit="millimetre"), text="unit"),
    bad("los box.ply out --to-radar nowhere.txt", text="nowhere.txt"),
    bad("los box.ply out --to-radar m.txt", put("m.txt", "1 2 3")),
    bad("los box.ply out --to-radar m.txt", put("m.txt", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1")),
    bad("los a.obj out --unit cm", put("a.obj", CUBE.format(9000)), text="90"),
    bad("los a.obj out", put("a.obj", CUBE.format(0)), text="a.obj"),
    bad("los a.obj out", put("a.obj", CUBE.format("x"))),
    bad("los a.obj out", put("a.obj", "f 1 2 3\n")),
    bad("los a.obj out", put("a.obj", CUBE.format(1) + "f 1 2 -99\n")),
    bad("los a.obj out", put("a.obj", b"\xff\xfe" + bytes(100))),
    bad("los a.stl out", put("a.stl", bytes(84))),
    bad("los a.stl out", put("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50))),
    bad("los a.glb out", put("a.glb", b"glTF")),
    bad("los a.glb out", put("a.glb", GLB)),
    bad("los a.gltf out", put("a.gltf", '{"buffers":[{"uri":"/etc/passwd","byteLength":9}]}')),
    bad("los a.xyz out", put("a.xyz", "1 2 3"), text="a.xyz"),
    bad("reconstruct scene out --los a.obj", put("a.obj", CUBE.format(0)), text="a.obj"),
    bad("reconstruct scene out --los box.ply", values("box.ply.json", unit="mm"), text="unit"),
    bad(
        "reconstruct scene out --los box.ply",
        values("box.ply.json", unit="cm\n\x1b[31m"),
        text="unit",
    ),
    bad("evaluate run --truth a.obj", put("a.obj", CUBE.format("nan"))),
    bad("evaluate run --truth a.obj", put("a.obj", "v 1 2 3\n")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "element face ", "element face 9")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "little", "middle")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "float x", "string x")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "end_header", "end_of_it")),
    bad("los 0.2xax0.2 out", text="0.2xax0.2"),
    bad("los 21x1x1 out", text="20 m"),
    *(
        bad("los box.ply out --to-radar m.json", put("m.json", text))
        for text in (
            "{}",
            "[1,2,3]",
            '[["a",0,0,0]]',
            "[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]",
            "[" * 9999,
            "\x00",
            "",
        )
    ),
    bad("los box.ply out --to-radar scene", text="scene"),
]
