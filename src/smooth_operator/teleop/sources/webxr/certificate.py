"""Self-signed certificate of the page, generated on first use and kept until it expires.

Browsers give WebXR to secure pages only, and a machine on a local network has no certificate that
they know. Most headsets let their user accept this one. Safari takes it for WebSockets only once
it is installed and trusted as a root, so it is one, but constrained (RFC 5280, 4.2.1.10) to the
names of this machine: a stolen key is of no use under other names.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import ipaddress
import os
import secrets
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.result_cache.own_files import make_private, read_own_file
from smooth_operator.result_cache.user_cache import OFF, SWITCH, user_cache

if TYPE_CHECKING:
    from cryptography import x509

VALID: Final = datetime.timedelta(days=365)  # Apple allows 825 days at most
_MOST_BYTES: Final = 100_000
_SPARE: Final = datetime.timedelta(days=1)  # one that runs out today would do so while it is used


@dataclass(frozen=True)
class Certificate:
    """A certificate that is ready for use.

    Attributes:
        file: key and certificate, PEM; only this user may read it.
        public: the certificate alone, PEM.
        expires: when it runs out.
        fingerprint: SHA-256, as browsers show it.
    """

    file: Path
    public: bytes
    expires: datetime.datetime
    fingerprint: str


def certificate_folder() -> Path | None:
    """Where certificates are kept; None if ``SWITCH`` turns that off."""
    if os.environ.get(SWITCH, "").strip().lower() in OFF:
        return None
    return user_cache() / "webxr"


def get_certificate(
    names: Sequence[str], folder: Path | None, now: datetime.datetime | None = None
) -> Certificate:
    """The certificate for these names: the one that was kept, or a new one.

    Each set of names has its own file, so that a laptop that alternates between two
    networks doesn't have its headset ask each time.

    Args:
        names: host names and addresses.
        folder: where it is kept; None for a folder of this run.
        now: the time, with time zone; now if left out.

    Raises:
        MissingExtraError: cryptography is not installed.
        SourceError: the folder can't be written, or belongs to another user.
    """
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("a headset's browser as source", "webxr") from error
    now = datetime.datetime.now(datetime.UTC) if now is None else now
    key = hashlib.sha256("\n".join(sorted(names)).encode()).hexdigest()[:12]
    place = Path(tempfile.mkdtemp(prefix="smooth-operator-")) if folder is None else folder
    file = place / f"certificate-{key}.pem"
    try:
        _make_private(place)
        stored = _read(file, now)
        if stored is not None:
            return stored
        _write(file, _make(names, now))
    except OSError as error:
        raise SourceError(
            f"can't keep the certificate of the headset's page in {str(place)!r}: "
            f"{error.strerror or error}; set {SWITCH} to a folder of yours, or to 'off'"
        ) from error
    created = _read(file, now)
    if created is None:
        raise SourceError(
            f"can't keep a certificate in {str(place)!r}: others could read it; "
            f"set {SWITCH} to a folder of yours"
        )
    return created


def _make_private(folder: Path) -> None:
    make_private(folder)
    if hasattr(os, "getuid"):
        if folder.stat().st_uid != os.getuid():
            raise SourceError(f"{str(folder)!r} belongs to another user; set {SWITCH} to another")
        folder.chmod(0o700)


def _read(file: Path, now: datetime.datetime) -> Certificate | None:
    """None if there is none, it is damaged, others may read it, or it is about to run out."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization

    try:
        text = read_own_file(file, _MOST_BYTES, secret=True)
        serialization.load_pem_private_key(text, None)
        certificate = x509.load_pem_x509_certificate(text)
    except (FileNotFoundError, ValueError, TypeError):
        return None
    if not certificate.not_valid_before_utc <= now < certificate.not_valid_after_utc - _SPARE:
        return None
    return Certificate(
        file,
        certificate.public_bytes(serialization.Encoding.PEM),
        certificate.not_valid_after_utc,
        certificate.fingerprint(hashes.SHA256()).hex(":").upper(),
    )


def _write(file: Path, text: bytes) -> None:
    temporary = file.with_name(f".{file.name}.{secrets.token_hex(4)}")
    # Private from its first byte on; in place of an older file in one step.
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(text)
        os.replace(temporary, file)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


def _make(names: Sequence[str], now: datetime.datetime) -> bytes:
    """Key and certificate, PEM."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "smooth-operator headset page")])
    public = key.public_key()
    usage = {
        name: name in ("digital_signature", "key_cert_sign")
        for name in (
            "digital_signature", "content_commitment", "key_encipherment", "data_encipherment",
            "key_agreement", "key_cert_sign", "crl_sign", "encipher_only", "decipher_only",
        )
    }  # fmt: skip
    built = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))  # headsets whose clock is behind
        .not_valid_after(now + VALID)
        .add_extension(x509.SubjectAlternativeName([_name(n) for n in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(x509.KeyUsage(**usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.NameConstraints([_subtree(n) for n in names], None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return private + built.public_bytes(serialization.Encoding.PEM)


def _name(name: str) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _subtree(name: str) -> x509.GeneralName:
    from cryptography import x509

    try:
        return x509.IPAddress(ipaddress.ip_network(name))
    except ValueError:
        return x509.DNSName(name)
