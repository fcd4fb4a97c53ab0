"""Named tables in LaTeX: sound by their text, and compiled where there is a pdflatex."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from fake_runs import ALL_TERMS, FRAMES, config, make_mixed_runs, make_run, metrics
from test_documents import nasty

from bench.cli import main
from bench.tables.document.latex import as_latex
from bench.tables.document.latex_text import latex_text
from bench.tables.named.find import table_names
from bench.tables.named.table import make_table

PDFLATEX = shutil.which("pdflatex")
PDFTOTEXT = shutil.which("pdftotext")
DOCUMENT = r"""\documentclass[twocolumn]{article}
\usepackage[margin=2cm]{geometry}
\usepackage{booktabs,graphicx}
\begin{document}
%s
\end{document}
"""


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    return make_mixed_runs(tmp_path / "my runs_&%")


@pytest.mark.parametrize("filled", [True, False])
@pytest.mark.parametrize("name", table_names())
def test_latex_is_sound(name: str, filled: bool, mixed: Path) -> None:
    r"""ASCII, balanced braces and environments, as many cells a row as columns, nothing special left bare."""
    text = make_table(name, [mixed] if filled else []).text("tex", Path())
    assert text.isascii()
    bare = re.sub(r"\\[\\&%$#_{}]", "", text)
    depth = 0
    for character in bare:
        depth += {"{": 1, "}": -1}.get(character, 0)
        assert depth >= 0
    assert depth == 0
    opened: list[str] = []
    for kind, environment in re.findall(r"\\(begin|end)\{([a-z*]+)\}", text):
        if kind == "begin":
            opened.append(environment)
        else:
            assert opened.pop() == environment
    assert not opened
    assert bare.count("$") % 2 == 0
    content = "\n".join(re.sub(r"%$", "", line) for line in bare.splitlines() if not line.startswith("%"))
    assert not re.search(r"[%#~]", content)
    assert not re.search(r"[_^]", re.sub(r"\$.*?\$", "", content.replace(rf"\label{{tab:{name}}}", "")))
    spec = text.partition(r"\begin{tabular}{")[2].partition("}")[0]
    body = text.partition(r"\toprule")[2].partition(r"\bottomrule")[0]
    rows = [row for row in body.splitlines() if row and row != r"\midrule"]
    assert all(row.endswith(r" \\") for row in rows)
    assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {len(spec)}
    known = {"textbf", "textit", "scriptsize", "pm", "times", "dagger", "uparrow", "downarrow", "midrule"}
    assert set(re.findall(r"\\([a-z]+)", body)) <= known


@pytest.fixture
def full(mixed: Path) -> Path:
    """Runs in nearly every cell, with long numbers, three seeds, daggers and crosses."""
    for seed in (0, 1, 2):
        for sequence, frames in FRAMES.items():
            for system in ("bgs_slam", "bgs_slam_fast", "bgs_slam_paper"):
                losses = ALL_TERMS if system == "bgs_slam_paper" else ("rgb", "ssim", "geo")
                scores = metrics(frames, psnr_db=20 + seed / 3, ssim=0.8, lpips=0.2, depth_l1_cm=1500 + seed / 3)
                scores["trajectory"] = {"ate_rmse_m": 1 / 3, "static_camera_ate_rmse_m": 92.16}
                part = 300 if system == "bgs_slam_fast" else None
                made = config(sequence, system, seed, losses=losses)
                make_run(mixed / f"{system}_{sequence}_{seed}", made, scores, frames=part)
        for number, sky in enumerate(("none", "u2net")):
            make_run(mixed / f"sky{number}{seed}", config("03", seed=seed, sky=sky), scores)
    return mixed


@pytest.mark.skipif(PDFLATEX is None, reason="there is no pdflatex here")
@pytest.mark.parametrize("name", table_names())
def test_every_table_compiles_and_fits_its_page(name: str, full: Path, tmp_path: Path) -> None:
    """Empty, sparse and full, one page each; nothing stands out of the text, and no sign is lost."""
    texts = [make_table(name, runs).text("tex", Path()) for runs in ([], [full / "c", full / "b"], [full])]
    (tmp_path / "t.tex").write_text(DOCUMENT % "\n\\clearpage\n".join(texts))
    command = [str(PDFLATEX), "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    for complaint in ("Overfull", "Float too large", "Missing character", "LaTeX Warning: Float"):
        assert complaint not in done.stdout, done.stdout[-2000:]
    assert "Output written on t.pdf (3 pages" in done.stdout
    if PDFTOTEXT and name == "main_kitti":
        subprocess.run([PDFTOTEXT, "-layout", "t.pdf"], cwd=tmp_path, check=True, timeout=60)
        printed = (tmp_path / "t.txt").read_text()
        assert "33.96" in printed, "SplaTAM's ATE on 10"
        assert "20.33 ± 0.33 (3)" in printed
        assert "a < b | 50 % & $x" in printed, "the reason of the run without memory"


@pytest.mark.skipif(PDFLATEX is None, reason="there is no pdflatex here")
@pytest.mark.parametrize("title", ["", "x}\\n\\input{/etc/passwd}"])
def test_nasty_text_compiles(title: str, tmp_path: Path) -> None:
    text = as_latex(replace(nasty(), title=title))
    (tmp_path / "t.tex").write_text(DOCUMENT % (text if title else rf"\resizebox{{\textwidth}}{{!}}{{{text}}}"))
    command = [str(PDFLATEX), "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.skipif(PDFLATEX is None, reason="there is no pdflatex here")
def test_the_table_of_runs_compiles(mixed: Path, tmp_path: Path) -> None:
    assert main(["table", str(mixed), "--out", str(tmp_path / "runs.tex")]) == 0
    (tmp_path / "t.tex").write_text(DOCUMENT % r"\resizebox{\textwidth}{!}{\input{runs.tex}}")
    command = [str(PDFLATEX), "-interaction=nonstopmode", "-halt-on-error", "t.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("50 % of a_b & #1", r"50 \% of a\_b \& \#1"),
        ("{~^$\\}", r"\{\textasciitilde{}\textasciicircum{}\$\textbackslash{}\}"),
        ("1 ± 2 \u2212 3 † \u00d7 < >", r"1 $\pm$ 2 $-$ 3 $^\dagger$ $\times$ $<$ $>$"),
        ("Zürich, 東", "Zurich, ?"),
    ],
)
def test_signs(text: str, expected: str) -> None:
    assert latex_text(text) == expected
