from pipeline.grids import leading_number


def test_cells_begin_with_a_number_or_do_not() -> None:
    cells = {"2.41 (2.18 to 2.72)": 2.41, "-3.0": -3.0, "99.9 %": 99.9, "45 ✓": 45.0, "18900": 18900.0, "0": 0.0}
    assert {cell: leading_number(cell) for cell in cells} == cells
    words = ("–", "", "R3", "2d_triangulation", "8-bit", "2026-11-23", "1.2.3", "56dc90", "3 → 4" * 0)
    assert [leading_number(word) for word in words] == [None] * len(words)
