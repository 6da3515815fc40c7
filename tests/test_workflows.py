"""The workflows of GitHub: pinned actions, bounded jobs, least permissions, targets that exist."""

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


def expanded(command, job):
    """Commands that a step runs, one for each entry of the job's matrix."""
    entries = job.get("strategy", {}).get("matrix", {}).get("include", [{}])
    for entry in entries:
        text = command
        for key, value in entry.items():
            text = text.replace(f"${{{{ matrix.{key} }}}}", value)
        yield text


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


def test_every_command_is_a_target_of_make(jobs, project_root):
    makefile = (project_root / "Makefile").read_text(encoding="utf-8")
    targets = {
        target
        for line in re.findall(r"^\.PHONY: (.+)$", makefile, re.MULTILINE)
        for target in line.split()
    }
    variables = set(re.findall(r"^(\w+) \?=", makefile, re.MULTILINE)) | set(
        re.findall(r"\$\((\w+)\)", makefile)
    )
    for name, job in jobs.items():
        for step in (step for step in job.get("steps", []) if "run" in step):
            for command in expanded(step["run"], job):
                program, *words = command.split()
                assert program == "make", (name, command)
                given = {word.partition("=")[0] for word in words if "=" in word}
                assert given <= variables, (name, command)
                asked = {word for word in words if "=" not in word}
                assert asked, (name, command)
                assert asked <= targets, (name, command)
