"""Who may join a fleet: users, rules of access and certificates, as Zenoh has them; and a bridge that hangs or is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import trio

from canopen_gateway import FleetError
from canopen_gateway.fleet import PlaceGone, bind_fleet_door, open_fleet
from tests.gateway.fleet_world import NODE, SITE, free_endpoint, real_time, seen
from tests.gateway.gateway_world import gateway

pytest.importorskip("zenoh", reason="the extra fleet is not installed")


def file_of(folder: Path, name: str, settings: object) -> Path:
    file = folder / f"{name}.json5"
    file.write_text(json.dumps(settings))
    return file


def user(name: str, password: str) -> dict[str, object]:
    return {"transport": {"auth": {"usrpwd": {"user": name, "password": password}}}}


_PROGRAM = "import sys; from canopen_cli.entry import main; sys.exit(main())"
MESSAGES = [
    "query",
    "reply",
    "put",
    "declare_queryable",
    "declare_subscriber",
    "declare_liveliness_subscriber",
    "liveliness_token",
    "liveliness_query",
]
RULES = {
    "enabled": True,
    "default_permission": "deny",
    "rules": [
        {
            "id": "look",
            "permission": "allow",
            "messages": [
                "query",
                "reply",
                "liveliness_token",
                "liveliness_query",
                "declare_liveliness_subscriber",
                "declare_queryable",
                "declare_subscriber",
                "put",
            ],
            "flows": ["ingress", "egress"],
            "key_exprs": ["canopen/v1/**"],
        },
        {
            "id": "no writes",
            "permission": "deny",
            "messages": ["query"],
            "flows": ["ingress"],
            "key_exprs": ["canopen/v1/*/*/*/set/*", "canopen/v1/*/*/*/command", "canopen/v1/*/*/lease"],
        },
    ],
    "subjects": [{"id": "viewer", "usernames": ["viewer"]}, {"id": "all", "usernames": ["engineer", "bridge"]}],
    "policies": [{"rules": ["look", "no writes"], "subjects": ["viewer"]}, {"rules": ["look"], "subjects": ["all"]}],
}


@pytest.mark.thorough
@real_time
async def test_users_prove_who_they_are_and_a_rule_lets_one_look_and_the_other_write(tmp_path: Path) -> None:
    passwords = tmp_path / "passwords"
    passwords.write_text("viewer:glass\nengineer:steel\nbridge:stone\n")
    endpoint = free_endpoint()
    settings = user("bridge", "stone")
    settings["transport"]["auth"]["usrpwd"]["dictionary_file"] = str(passwords)  # type: ignore[index]
    door = await bind_fleet_door(
        SITE, listen=[endpoint], config=file_of(tmp_path, "bridge", {**settings, "access_control": RULES})
    )
    async with door, gateway(3, allow="write") as (_, service), trio.open_nursery() as nursery:
        nursery.start_soon(door.serve, service)
        for name, password, sees, writes in (
            ("engineer", "steel", True, True),
            ("viewer", "glass", True, False),
            ("viewer", "steel", False, False),
            ("nobody", "glass", False, False),
        ):
            async with open_fleet(
                connect=[endpoint], config=file_of(tmp_path, "viewer", user(name, password)), patience=2
            ) as viewer:
                if not sees:
                    await viewer.settled(longest=2)
                    assert not viewer.buses, name
                    continue
                await seen(lambda viewer=viewer: len(viewer.nodes) == 1)  # type: ignore[misc]
                before = (await viewer.read(NODE, 0x1017)).value
                assert isinstance(before, int)
                if writes:
                    await viewer.write(NODE, 0x1017, before + 1)
                else:
                    with pytest.raises(FleetError, match="nobody answers"):
                        await viewer.write(NODE, 0x1017, before + 1)
                assert (await viewer.read(NODE, 0x1017)).value == before + writes
        nursery.cancel_scope.cancel()


def certify(folder: Path) -> None:
    """Make an authority, and a certificate for each of bridge and viewer; and one for a stranger, by another authority."""

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], check=True, cwd=folder, capture_output=True, timeout=60)

    for authority in ("ca", "other"):
        openssl("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "3650",
                "-keyout", f"{authority}.key", "-out", f"{authority}.pem", "-subj", f"/CN={authority}")  # fmt: skip
    (folder / "names").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\nextendedKeyUsage=serverAuth,clientAuth\n")
    for name, authority in (("bridge", "ca"), ("viewer", "ca"), ("stranger", "other")):
        openssl("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", f"{name}.key",
                "-out", f"{name}.csr", "-subj", f"/CN={name}")  # fmt: skip
        openssl("x509", "-req", "-in", f"{name}.csr", "-CA", f"{authority}.pem", "-CAkey", f"{authority}.key", "-CAcreateserial",
                "-days", "3650", "-extfile", "names", "-out", f"{name}.pem")  # fmt: skip


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
@real_time
async def test_with_certificates_a_stranger_stays_out_and_any_address_may_be_listened_at(tmp_path: Path) -> None:
    certify(tmp_path)

    def tls(name: str) -> dict[str, object]:
        settings: dict[str, object] = {"enable_mtls": True, "verify_name_on_connect": True}
        settings["root_ca_certificate"] = str(tmp_path / "ca.pem")
        for side in ("listen", "connect"):
            settings[f"{side}_private_key"] = str(tmp_path / f"{name}.key")
            settings[f"{side}_certificate"] = str(tmp_path / f"{name}.pem")
        return {"transport": {"link": {"tls": settings}}}

    port = free_endpoint().rpartition(":")[2]
    door = await bind_fleet_door(SITE, listen=[f"tls/0.0.0.0:{port}"], config=file_of(tmp_path, "bridge", tls("bridge")))
    async with door, gateway(3) as (_, service), trio.open_nursery() as nursery:
        nursery.start_soon(door.serve, service)
        endpoint = f"tls/localhost:{port}"
        async with open_fleet(connect=[endpoint], config=file_of(tmp_path, "viewer", tls("viewer"))) as viewer:
            await seen(lambda: len(viewer.nodes) == 1)
            assert (await viewer.read(NODE, 0x1001)).value == 0
        async with open_fleet(connect=[endpoint], config=file_of(tmp_path, "stranger", tls("stranger"))) as stranger:
            await stranger.settled(longest=2)
            assert not stranger.buses
        nursery.cancel_scope.cancel()


@contextmanager
def bridge_process(endpoint: str) -> Iterator[subprocess.Popen[str]]:
    """`canopen serve zenoh` over the six simulated drives, in a process of its own."""
    words = [sys.executable, "-c", _PROGRAM, "serve", "zenoh", "--site", SITE, "-b", "demo", "--listen", endpoint]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGCONT)
            process.kill()


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="signals that this system does not have")
@real_time
async def test_a_bridge_that_hangs_is_away_and_comes_back_and_one_that_is_killed_is_gone() -> None:
    endpoint, node = free_endpoint(), f"{SITE}/virtual-demo/3"
    with bridge_process(endpoint) as process:
        async with open_fleet(connect=[endpoint]) as viewer:
            await seen(lambda: len(viewer.nodes) == 6)
            with viewer.news(PlaceGone) as news:
                os.kill(process.pid, signal.SIGSTOP)
                for _ in range(7):
                    await news.receive()
                assert not viewer.buses
                with pytest.raises(FleetError, match="nobody answers"):
                    await viewer.read(node, 0x1001)
                os.kill(process.pid, signal.SIGCONT)
                await seen(lambda: len(viewer.nodes) == 6)
                assert (await viewer.read(node, 0x1001)).value == 0
                process.kill()
                for _ in range(7):
                    await news.receive()
                assert not viewer.buses
