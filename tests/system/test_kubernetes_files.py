"""What can be checked of the manifests for Kubernetes without a cluster: their schemas, and how they fit together."""

from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import pytest
import yaml

from wrongturn_ray.settings import RaySettings
from wrongturn_service.settings import Settings

FOLDER = Path(__file__).parents[2] / "docker/kubernetes"
MANIFESTS = [manifest for file in sorted(FOLDER.glob("*.yaml")) for manifest in yaml.safe_load_all(file.read_text())]
KUBERNETES = "1.33"


def _closed(required: list[str] | None = None, **properties: object) -> dict[str, Any]:
    return {"type": "object", "required": required or [], "additionalProperties": False, "properties": properties}


_GROUP = {
    "template": {"type": "object", "required": ["spec"]},
    "rayStartParams": {"type": "object", "additionalProperties": {"type": "string"}},
}
_COUNTS = {name: {"type": "integer", "minimum": 0} for name in ("replicas", "minReplicas", "maxReplicas")}
_WORKERS = ["groupName", "maxReplicas", "minReplicas", "template"]
RAY_CLUSTER = {
    "type": "object",
    "required": ["apiVersion", "kind", "metadata", "spec"],
    "properties": {
        "apiVersion": {"const": "ray.io/v1"},
        "spec": _closed(
            ["headGroupSpec"],
            rayVersion={"type": "string"},
            authOptions=_closed(mode={"enum": ["disabled", "token"]}),
            headGroupSpec=_closed(["template"], **_GROUP),
            workerGroupSpecs={
                "type": "array",
                "items": _closed(_WORKERS, groupName={"type": "string"}, **_COUNTS, **_GROUP),
            },
        ),
    },
}
"""Those fields of KubeRay's ``ray.io/v1`` that we use, and no others, so that a misspelt one is found."""


def _only(kind: str, name: str) -> Any:
    (found,) = (one for one in MANIFESTS if (one["kind"], one["metadata"]["name"]) == (kind, name))
    return found


def _valid(manifest: dict[str, Any]) -> None:
    """Check a manifest against the schema of its kind, in which no other fields are allowed."""
    if manifest["kind"] != "RayCluster":
        kubernetes_validate.validate(manifest, KUBERNETES, strict=True)
        return
    jsonschema.validate(manifest, RAY_CLUSTER)
    for group in _groups(manifest):
        kubernetes_validate.validate({"apiVersion": "v1", "kind": "Pod", **group["template"]}, KUBERNETES, strict=True)


def _groups(cluster: dict[str, Any]) -> list[Any]:
    return [cluster["spec"]["headGroupSpec"], *cluster["spec"]["workerGroupSpecs"]]


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda one: f"{one['kind']}-{one['metadata']['name']}")
def test_a_manifest_keeps_its_schema_and_a_misspelt_field_does_not(manifest: dict[str, Any]) -> None:
    _valid(manifest)
    wrong = {**manifest, "spec": {**manifest["spec"], "replicsa": 1}}
    with pytest.raises((jsonschema.ValidationError, kubernetes_validate.ValidationError)):
        _valid(wrong)


def test_every_pod_is_hardened_and_has_limits() -> None:
    pods = [_only("Deployment", "wrongturn")["spec"]["template"], *(g["template"] for g in _groups(_cluster()))]
    for pod in pods:
        spec = pod["spec"]
        assert not spec["automountServiceAccountToken"]
        assert (spec["securityContext"]["runAsNonRoot"], spec["securityContext"]["runAsUser"]) == (True, 10001)
        (container,) = spec["containers"]
        assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
        assert not container["securityContext"]["allowPrivilegeEscalation"]
        assert container["resources"]["limits"]["memory"]


def _cluster() -> Any:
    return _only("RayCluster", "wrongturn-ray")


def test_service_and_cluster_find_each_other() -> None:
    (container,) = _only("Deployment", "wrongturn")["spec"]["template"]["spec"]["containers"]
    settings = {variable["name"]: variable.get("value") for variable in container["env"]}
    ours = {name for name in settings if name.startswith("WRONGTURN_")}
    assert {f"WRONGTURN_{name.upper()}" for name in Settings.model_fields | RaySettings.model_fields} >= ours
    # KubeRay names the head's service, and the secret with the cluster's token, after the cluster.
    name = _cluster()["metadata"]["name"]
    assert settings["WRONGTURN_RAY_ADDRESS"] == f"{name}-head-svc:6379"
    (token,) = (variable["valueFrom"] for variable in container["env"] if "valueFrom" in variable)
    assert token == {"secretKeyRef": {"name": name, "key": "auth_token"}}
    (port,) = _only("Service", "wrongturn")["spec"]["ports"]
    assert port["targetPort"] in {port["name"] for port in container["ports"]}


def test_only_nodes_of_the_cluster_reach_more_than_http_and_only_friends_reach_ray() -> None:
    label = {"matchLabels": {"ray.io/cluster": _cluster()["metadata"]["name"]}}
    assert _only("NetworkPolicy", "wrongturn")["spec"]["ingress"] == [
        {"ports": [{"port": 8000}]},
        {"from": [{"podSelector": label}]},
    ]
    policy = _only("NetworkPolicy", "wrongturn-ray")["spec"]
    assert policy["podSelector"] == label
    (rule,) = policy["ingress"]
    assert {"podSelector": label} in rule["from"]


def test_the_page_builds_the_image_of_every_pod() -> None:
    images = {c["image"] for g in _groups(_cluster()) for c in g["template"]["spec"]["containers"]}
    (container,) = _only("Deployment", "wrongturn")["spec"]["template"]["spec"]["containers"]
    assert images == {container["image"]} == {"wrongturn-service-ray"}
    assert "-t wrongturn-service-ray " in (FOLDER.parents[1] / "docs/compose.md").read_text("utf-8")
