"""OPC UA signed and encrypted, against asyncua's server: only with the right certificates, user and password."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.user_managers import UserManager

from polishd.api import ConfigError, DeviceContext, LinkError
from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.device_types import PlcRobotOptions, build
from polishd.drivers.plc_robot.opcua import OpcUa, OpcUaCertificates
from polishd.sim_backends.plc_robot.device import NAMESPACE, OPCUA_TYPES

PROFILE = load_controller_profile("plc-opcua", Path())
SILENCE_S = 20.0


def papers_of(folder: Path, name: str, uri: str) -> tuple[Path, Path]:
    """A certificate and its key, made as docs/how-to/plc-robot.md says."""
    key, certificate = folder / f"{name}.key", folder / f"{name}.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "9", "-keyout", key, "-out", certificate,
         "-subj", f"/CN={name}", "-addext", f"subjectAltName=URI:{uri},DNS:{socket.gethostname()}"],
        check=True, capture_output=True,
    )  # fmt: skip
    return certificate, key


class OneUser(UserManager):
    """Accepts the right password."""

    def get_user(
        self, iserver: object, username: str | None = None, password: str | None = None, certificate: object = None
    ) -> User | None:
        return User(UserRole.User, "polishd") if (username, password) == ("polishd", "right") else None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("papers")
    papers_of(folder, "polishd", "urn:polishd")
    papers_of(folder, "server", "urn:controller")
    papers_of(folder, "other", "urn:controller")
    return folder


@pytest.fixture
async def url(folder: Path) -> AsyncIterator[str]:
    """A server that takes nothing in the clear."""
    server = Server(user_manager=OneUser())
    await server.init()
    await server.set_application_uri("urn:controller")
    server.set_endpoint("opc.tcp://127.0.0.1:0")
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    await server.load_certificate(str(folder / "server.pem"))
    await server.load_private_key(str(folder / "server.key"), format="PEM")
    index = await server.register_namespace(NAMESPACE)
    for name, kind in OPCUA_TYPES.items():
        node = ua.NodeId.from_string(f"ns={index};s={name}")
        value = "" if kind is ua.VariantType.String else ua.get_default_value(kind)
        await server.nodes.objects.add_variable(node, name, value, kind)
    await server.start()
    assert server.bserver is not None
    yield f"opc.tcp://127.0.0.1:{server.bserver.port}"
    await server.stop()


def client(
    url: str,
    folder: Path,
    *,
    ours: str = "polishd",
    theirs: str = "server",
    password: str = "right",
    silence_s: float = SILENCE_S,
) -> OpcUa:
    papers = OpcUaCertificates(folder / f"{ours}.pem", folder / f"{ours}.key", folder / f"{theirs}.pem")
    return OpcUa(url, PROFILE.variables, silence_s, "polishd", password, papers=papers)


@pytest.mark.full
async def test_it_speaks_to_a_server_that_takes_nothing_in_the_clear(url: str, folder: Path) -> None:
    link = client(url, folder)
    await link.open()
    assert (await link.read()).values["state"] == 0
    await link.close()
    plain = OpcUa(url, PROFILE.variables, SILENCE_S, "polishd", "right")
    with pytest.raises(LinkError, match="cannot be opened"):
        await plain.open()


@pytest.mark.full
async def test_another_server_is_not_spoken_to(url: str, folder: Path) -> None:
    """It cannot read what is meant for another, and keeps silent."""
    with pytest.raises(LinkError, match=r"cannot be opened with these certificates"):
        await client(url, folder, theirs="other", silence_s=2.0).open()


@pytest.mark.full
async def test_the_wrong_password_is_reported(url: str, folder: Path) -> None:
    with pytest.raises(LinkError, match=r"cannot be opened with .*: User does not .*Denied"):
        await client(url, folder, password="wrong").open()


@pytest.mark.full
async def test_a_file_that_is_no_certificate_is_reported(url: str, folder: Path) -> None:
    (folder / "broken.pem").write_text("-----BEGIN CERTIFICATE-----")
    with pytest.raises(LinkError, match="cannot be opened"):
        await client(url, folder, theirs="broken").open()


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"certificate": "polishd.pem"}, "private_key is missing; encrypted opcua needs certificate, private_key"),
        ({"certificate": "gone.pem", "private_key": "polishd.key"}, "certificate 'gone.pem' is not a file"),
    ],
)
def test_papers_that_are_not_complete_are_refused_before_anything_is_opened(
    folder: Path, keys: dict[str, str], says: str
) -> None:
    options = PlcRobotOptions(
        profile="plc-opcua", address="opc.tcp://10.0.0.7:4840", delivery="folder:programs", **keys
    )
    with pytest.raises(ConfigError, match=says):
        build(options, DeviceContext(folder, folder, "P", []))


@pytest.mark.parametrize("mode", [0o640, 0o660, 0o662])
def test_a_private_key_that_others_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    names = {"certificate": "polishd.pem", "private_key": "polishd.key", "server_certificate": "server.pem"}
    for name in names.values():
        (tmp_path / name).touch()
    (tmp_path / "polishd.key").chmod(mode)
    options = PlcRobotOptions(
        profile="plc-opcua", address="opc.tcp://10.0.0.7:4840", delivery="folder:programs", **names
    )
    with pytest.raises(ConfigError, match=r"private_key 'polishd\.key': mode 06\d\d of .*Run: chmod 600 "):
        build(options, DeviceContext(tmp_path, tmp_path, "P", []))
