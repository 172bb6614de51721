"""Compose file, Kubernetes manifests, Dockerfiles and workflows, against their schemas, linters and our own rules."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml
from cloudcoil.models.keda.v1alpha1 import ScaledObject, TriggerAuthentication
from pydantic import BaseModel

from deploy.by_hand import IMAGES, read_dockerfile, stages

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
MANIFESTS = sorted(
    path for path in (ROOT / "deploy/kubernetes").glob("*.yaml") if path.name not in ("kustomization.yaml",)
)
DOCUMENTS: dict[str, dict[str, Any]] = {
    f"{path.name}:{document['kind']}/{document['metadata']['name']}": document
    for path in MANIFESTS
    for document in yaml.safe_load_all(path.read_text(encoding="utf-8"))
}
WORKLOADS = ("Deployment", "StatefulSet")
KUBERNETES = "1.33"


def _pods() -> dict[str, dict[str, Any]]:
    found = _of_kind(*WORKLOADS)
    return {document["metadata"]["name"]: document["spec"]["template"]["spec"] for document in found}


def _of_kind(*kinds: str) -> list[dict[str, Any]]:
    return [document for document in DOCUMENTS.values() if document["kind"] in kinds]


def _schema(name: str, *files: Path) -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", name, *map(str, files)]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_the_compose_file_has_the_form_of_one() -> None:
    _schema("vendor.compose-spec", ROOT / "docker-compose.yml")


def test_the_workflows_have_the_form_of_workflows() -> None:
    _schema("vendor.github-workflows", *sorted((ROOT / ".github/workflows").glob("*.yml")))


@pytest.mark.parametrize("document", DOCUMENTS.values(), ids=DOCUMENTS)
def test_each_manifest_has_the_form_of_its_kind(document: dict[str, Any]) -> None:
    models: dict[str, type[BaseModel]] = {"ScaledObject": ScaledObject, "TriggerAuthentication": TriggerAuthentication}
    if document["kind"] in models:
        models[document["kind"]].model_validate(document)
    else:
        kubernetes_validate.validate(document, KUBERNETES, strict=True)


def test_the_kustomization_names_every_manifest() -> None:
    listed = yaml.safe_load((ROOT / "deploy/kubernetes/kustomization.yaml").read_text(encoding="utf-8"))
    assert sorted(listed["resources"]) == [path.name for path in MANIFESTS]


@pytest.mark.parametrize("image", IMAGES)
def test_hadolint_has_nothing_to_say(image: str) -> None:
    command = [str(BIN / "hadolint"), "-c", str(ROOT / ".hadolint.yaml"), str(ROOT / f"deploy/Dockerfile.{image}")]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout


@pytest.mark.parametrize("image", IMAGES)
def test_what_is_copied_is_there(image: str) -> None:
    text = (ROOT / f"deploy/Dockerfile.{image}").read_text(encoding="utf-8")
    for name, rest in read_dockerfile(text):
        if name == "COPY" and not rest.startswith("--from="):
            assert all((ROOT / source).exists() for source in rest.split()[:-1]), rest


@pytest.mark.parametrize("image", IMAGES)
def test_the_last_stage_runs_as_nobody_and_has_a_health_check(image: str) -> None:
    text = (ROOT / f"deploy/Dockerfile.{image}").read_text(encoding="utf-8")
    last = dict(list(stages(read_dockerfile(text)))[-1][1])
    assert last["USER"] == "10001:10001" and "HEALTHCHECK" in last and "g++" not in last["RUN"]


def test_the_wheels_stage_is_the_same_in_all_images() -> None:
    """Check that the wheels' stage is the same in all images, so that Docker builds it once."""
    texts = [(ROOT / f"deploy/Dockerfile.{image}").read_text(encoding="utf-8") for image in IMAGES]
    wheels = [next(stages(read_dockerfile(text))) for text in texts]
    assert wheels[0] == wheels[1] == wheels[2]


def test_the_services_image_gets_no_torch() -> None:
    asked = subprocess.run(
        [sys.executable, "deploy/requirements.py", "service"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    assert "fastapi" in asked and not re.search(r"torch|open3d|numpy|scipy|pycolmap|^av\b", asked, re.MULTILINE)


@pytest.mark.parametrize("image", ["worker-cpu", "worker-gpu"])
def test_the_workers_find_cameras_and_read_videos(image: str) -> None:
    asked = subprocess.run(
        [sys.executable, "deploy/requirements.py", image], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    assert {"pycolmap", "av"} <= set(re.findall(r"^[\w.-]+", asked, re.MULTILINE))


@pytest.mark.parametrize("name", COMPOSE["services"])
def test_a_container_has_no_more_rights_than_it_needs(name: str) -> None:
    service = COMPOSE["services"][name]
    assert service["read_only"] and service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    assert not service.get("privileged") and ":latest" not in service["image"]
    if name in ("redis", "store", "bucket"):
        assert service["networks"] == ["inner"] and "ports" not in service
    if name != "bucket":
        assert service["deploy"]["resources"]["limits"]["memory"]


def test_only_the_service_is_published() -> None:
    assert [name for name, service in COMPOSE["services"].items() if "ports" in service] == ["service"]
    assert COMPOSE["networks"]["inner"] == {"internal": True}


@pytest.mark.parametrize("name", _pods())
def test_a_pod_has_limits_probes_and_no_more_rights_than_it_needs(name: str) -> None:
    pod = _pods()[name]
    assert pod["securityContext"]["runAsNonRoot"] and not pod["automountServiceAccountToken"]
    for container in pod["containers"]:
        assert container["livenessProbe"] and container["resources"]["limits"]["memory"]
        rights = container["securityContext"]
        assert rights["readOnlyRootFilesystem"] and not rights["allowPrivilegeEscalation"]
        assert rights["capabilities"] == {"drop": ["ALL"]}


def test_the_network_is_closed_but_for_what_is_named() -> None:
    policies = {document["metadata"]["name"]: document["spec"] for document in _of_kind("NetworkPolicy")}
    assert policies["nothing"] == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}


def test_workers_get_time_to_hand_their_job_back() -> None:
    from service.contract.settings import Settings

    grace = Settings.model_fields["stop_grace"].default
    assert _pods()["worker-cpu"]["terminationGracePeriodSeconds"] >= grace + 20
    assert int(COMPOSE["services"]["worker"]["stop_grace_period"].removesuffix("s")) >= grace + 20


def test_the_scalers_look_at_the_keys_of_rq() -> None:
    from rq import Queue
    from rq.registry import StartedJobRegistry

    scaled = _of_kind("ScaledObject")
    assert scaled
    for document in scaled:
        queue = document["metadata"]["name"].removeprefix("worker-")
        lists = [trigger["metadata"]["listName"] for trigger in document["spec"]["triggers"]]
        assert lists == [f"{Queue.redis_queue_namespace_prefix}{queue}", StartedJobRegistry.key_template.format(queue)]
