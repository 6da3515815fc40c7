"""Scores of one scene of the population."""

from geraf2.evaluation import evaluate_mesh
from geraf2.evaluation.mesh_metrics import FINE_SAMPLES
from geraf2.io.mesh import TriangleMesh

THRESHOLDS_M = (0.005, 0.003, 0.002)


def population_scores(
    mesh: TriangleMesh, truth: TriangleMesh, seed: int, *, num_threads: int | None = None
) -> dict[str, float]:
    """Scores of a reconstructed surface by name; lengths in millimetres.

    mesh: the content, with expected errors where the preset has them.
    truth: the true surface, closed.
    seed: of the points that are drawn.
    """
    metrics = evaluate_mesh(
        mesh,
        truth,
        n_samples=FINE_SAMPLES,
        seed=seed,
        thresholds_m=THRESHOLDS_M,
        num_threads=num_threads,
    )
    scores = metrics.headline()
    if metrics.expected_error is not None:
        scores["within_one"] = metrics.expected_error.within_one
        scores["within_two"] = metrics.expected_error.within_two
        scores["rank"] = metrics.expected_error.rank_correlation
    return scores
