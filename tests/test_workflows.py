"""The workflows of GitHub: pinned actions and the least permissions."""

import re

import pytest

yaml = pytest.importorskip("yaml", reason="pip install pyyaml")

# Permission to write, by workflow and job; everything else reads.
MAY_WRITE = {
    ("pages", "deploy"): {"pages", "id-token"},
    ("release", "publish"): {"id-token"},
    ("release", "github"): {"contents"},
}


@pytest.fixture(scope="module")
def folder(project_root):
    folder = project_root / ".github"
    if not folder.is_dir():
        pytest.skip("needs a checkout; the source distribution leaves .github out")
    return folder


@pytest.fixture(scope="module")
def workflows(folder):
    paths = sorted((folder / "workflows").glob("*.yml"))
    assert paths
    return {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in paths}


@pytest.fixture(scope="module")
def jobs(workflows):
    return {
        (workflow, name): job
        for workflow, content in workflows.items()
        for name, job in content["jobs"].items()
    }


def test_actions_are_pinned_by_digest_with_their_version(folder):
    for path in (folder / "workflows").glob("*.yml"):
        lines = path.read_text(encoding="utf-8").splitlines()
        for line in (line for line in lines if re.search(r"\buses:", line)):
            local = re.search(r"uses: \./(\S+)$", line)
            if local:
                assert (folder.parent / local[1]).is_file(), line
            else:
                assert re.search(r"uses: [\w.-]+/[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+$", line), (
                    line
                )


def test_permissions_are_the_least(workflows, jobs):
    for name, content in workflows.items():
        assert content["permissions"] == {"contents": "read"}, name
    for name, job in jobs.items():
        permissions = job.get("permissions", {})
        assert {key for key, value in permissions.items() if value != "read"} == MAY_WRITE.get(
            name, set()
        )


def test_a_checkout_keeps_no_credentials(jobs):
    steps = [step for job in jobs.values() for step in job.get("steps", [])]
    checkouts = [step for step in steps if step.get("uses", "").startswith("actions/checkout@")]
    assert checkouts
    assert all(step["with"]["persist-credentials"] is False for step in checkouts)
