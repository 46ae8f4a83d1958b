"""Certificates: what `wyner certs` makes, keeps, renews and refuses; checked with openssl."""

import stat
import subprocess
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S
from wyner.cli.main import main
from wyner.deployment.certificates import (
    CertificateError,
    check_host,
    check_name,
    ensure_certificates,
    is_current,
    make_authority,
    make_certificate,
)

HOSTS = {"plant": ["plant.example.org", "192.0.2.7", "::1"], "tap": ["localhost"]}


def openssl(*arguments: str) -> str:
    done = subprocess.run(
        ["openssl", *arguments], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    return done.stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "certs"
    assert ensure_certificates(folder, HOSTS, 30) == ["plant", "tap"]
    return folder


def test_each_service_gets_a_chain_for_both_directions_of_tls(folder: Path) -> None:
    for name in HOSTS:
        for purpose in ("sslserver", "sslclient"):
            said = openssl(
                "verify", "-x509_strict", "-purpose", purpose,
                "-CAfile", str(folder / name / "ca.pem"), str(folder / name / "cert.pem"),
            )  # fmt: skip
            assert said.strip().endswith("OK")


def test_the_certificate_names_the_service_and_its_hosts(folder: Path) -> None:
    certificate = str(folder / "plant/cert.pem")
    subject = openssl("x509", "-in", certificate, "-noout", "-subject")
    assert subject.replace(" ", "").strip() == "subject=CN=plant"
    names = openssl("x509", "-in", certificate, "-noout", "-ext", "subjectAltName")
    for expected in ("DNS:plant.example.org", "IP Address:192.0.2.7", "IP Address:0:0:0:0:0:0:0:1"):
        assert expected in names
    assert "localhost" not in names


def test_keys_are_readable_to_their_owner_only_and_nothing_else_is_left(folder: Path) -> None:
    for key in (folder / "ca-key.pem", folder / "plant/key.pem", folder / "tap/key.pem"):
        assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert {p.name for p in folder.iterdir()} == {"ca.pem", "ca-key.pem", "plant", "tap"}
    assert {p.name for p in (folder / "plant").iterdir()} == {"ca.pem", "cert.pem", "key.pem"}


def test_what_is_valid_is_kept(folder: Path) -> None:
    before = {p: p.read_bytes() for p in folder.rglob("*.pem")}
    assert ensure_certificates(folder, HOSTS, 30) == []
    assert {p: p.read_bytes() for p in folder.rglob("*.pem")} == before


def test_a_certificate_about_to_end_is_made_anew(folder: Path) -> None:
    make_certificate(folder, "tap", ["localhost"], 1)
    assert not is_current(folder, "tap")
    assert ensure_certificates(folder, HOSTS, 30) == ["tap"]
    assert is_current(folder, "tap")


def test_a_new_authority_replaces_all_it_did_not_sign(folder: Path) -> None:
    for name in ("ca.pem", "ca-key.pem"):
        (folder / name).unlink()
    assert ensure_certificates(folder, HOSTS, 30) == ["plant", "tap"]
    openssl("verify", "-CAfile", str(folder / "ca.pem"), str(folder / "plant/cert.pem"))


def test_a_certificate_of_another_authority_is_not_taken_for_ones_own(
    folder: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    make_authority(other, 30)
    make_certificate(other, "plant", ["localhost"], 30)
    (folder / "plant/cert.pem").write_bytes((other / "plant/cert.pem").read_bytes())
    assert not is_current(folder, "plant")


@pytest.mark.parametrize("gone", ["ca.pem", "ca-key.pem"])
def test_half_an_authority_is_refused(folder: Path, gone: str) -> None:
    (folder / gone).unlink()
    with pytest.raises(CertificateError, match=r"is there and .* is not; expected both or neither"):
        ensure_certificates(folder, HOSTS, 30)


@pytest.mark.parametrize("name", ["", "..", "a/b", "-x", "a b", "x" * 65, "a\nCN = b"])
def test_names_that_could_do_harm_are_refused(name: str) -> None:
    with pytest.raises(CertificateError, match="expected 1 to 64"):
        check_name(name)


@pytest.mark.parametrize(
    "host", ["", "a b", "a,DNS:b", "-x", "300.1.1.1.", "a..b", "a" * 254, "a\nDNS = b"]
)
def test_hosts_that_are_none_are_refused(host: str) -> None:
    with pytest.raises(CertificateError, match="expected an IP address or a host's name"):
        check_host(host)


def test_a_machine_without_openssl_is_told_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CertificateError, match="openssl: not found"):
        make_authority(tmp_path / "certs", 30)
    assert not (tmp_path / "certs/ca.pem").exists()


# --- the command ----------------------------------------------------------------------------------


def test_the_command_says_what_it_made_and_what_it_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["certs", str(tmp_path), "--name", "plant=plant.example.org"]
    assert main(arguments) == 0
    assert main([*arguments, "--name", "tap"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"made {tmp_path}/plant",
        f"kept {tmp_path}/plant",
        f"made {tmp_path}/tap",
    ]
    names = openssl(
        "x509", "-in", str(tmp_path / "plant/cert.pem"), "-noout", "-ext", "subjectAltName"
    )
    for expected in ("plant.example.org", "plant.field", "localhost", "127.0.0.1"):
        assert expected in names
