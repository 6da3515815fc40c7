"""Applications: batches, belts, benchmarks, inspections, live scans and plans."""

from bad_inputs.rows import CUBE
from bad_inputs.table import bad, put, table


def lines(text):
    return text.replace(";", "\n")


ROWS = [
    *(
        bad(line, text=text)
        for line, text in table("""
            benchmark out --seeds 1:2|--seeds is for --only population
            benchmark out --only population|needs --seeds A:B
            benchmark out --only population --seeds 7:7|A:B
            benchmark out --only population --seeds 0:1000000|A:B
            benchmark out --only population --seeds 1:2 --quick|--quick does not go with
            benchmark out --only population table1 --seeds 1:2|run each by itself
            benchmark out --only population --seeds 1:2 --presets fats|did you mean 'fast'
            benchmark out --only population --seeds 1:2 --against other|has no results of --only
            benchmark out --only table1 --presets fast|--presets
            benchmark out --only population table1|alone
            live tcp://example.org:80 out|is no socket of this machine
            live tcp://localhost out|is no socket of this machine
            live tcp://localhost:x out|is no socket of this machine
            belt empty out --idle-s 0.2|belt.json
            belt scene other|holds files
            batch nowhere out|nowhere: no such scene
            batch nowhere* out|no scene has such a name
            batch scans.csv out|scans.csv: no such file
            batch other out|is not a scene
            batch scene out --workers 1 --scheduler tcp://a:1|either --workers or
            compare run empty|is no run folder
            view empty|is no run folder
            view run run run|run
            inspect empty|is no run folder
            inspect other/diary.txt|is no run folder
            inspect run --scene none|none: no such scene
            inspect run --cad none.stl|does not exist
            inspect run --cad box.ply box.ply|the same CAD file is given twice
            inspect run --expect none.toml|no such file
        """)
    ),
    *(
        bad("batch table.csv scene/out --box 1 1 1", put("table.csv", lines(cells)), text=text)
        for cells, text in table("""
            scene,boxes;scene,1|unknown column 'boxes', did you mean 'box'?
            box;1 1 1|has no column 'scene'
            scene,box;,1 1 1|line 2: names no scene
            scene,box;scene,1 1 1;two|line 3: has more or fewer cells than columns
            scene,box;scene,1 1|line 2: box, expected three lengths [m], got 1 1
            scene,box,prior;scene,1 1 1,box.ply|line 2: give either box or prior
            scene,box;four,1 1 1|four: no such scene
            scene,prior;scene,none.ply|none.ply: no such file
            scene,box;scene,2 1 1;scene,|scene: the same scene twice, with different boxes
            scene|there is no scene
        """)
    ),
    *(
        bad("inspect run --expect list.toml", put("list.toml", lines(items)), text=text)
        for items, text in table("""
            |item
            [[item]];name="a"|cad
            [[item]];name="a";cad="box.ply";size_mm=[1]|unknown key 'item[0].size_mm'
            [[item]];name="a";cad="box.ply";material="gold"|gold
            [[item]];name="a";cad="box.ply";[[item]];name="a";cad="b.ply"|same name is listed twice
            [[item]];name="a";cad="box.ply";[[item]];name="b";cad="box.ply"|CAD file is listed twice
        """)
    ),
    *(
        bad("inspect run --cad a.obj", put("a.obj", obj), text=text)
        for obj, text in (
            (CUBE.format("5e5"), "as large as nothing in the box"),
            (CUBE.format(50).replace("f 1 4 3\n", ""), "a.obj: the CAD model is not closed"),
        )
    ),
]
