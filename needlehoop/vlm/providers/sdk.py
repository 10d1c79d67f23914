"""What the providers that use a company's own package (SDK) have in common.

A server may be hostile: here is also how its replies arrive, and what is read of them.
"""

from __future__ import annotations

import json
import re
import threading
import time
from abc import ABC, abstractmethod
from importlib import import_module
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from needlehoop.runs.reading import UnreadableError, parse_json, printable
from needlehoop.vlm.messages import Request, mistakes
from needlehoop.vlm.providers.contract import LiveConfig, ProviderError, Reply

R = TypeVar("R", bound="ReplyPart")

Count = Annotated[int, Field(ge=0, le=2**53)]

LARGEST = 1_000_000
"""Bytes of a reply, at most; a usual one has about 5,000. Reading stops there."""

_LONGEST_ERROR = 300
"""Characters of a server's error that are passed on."""


class WireError(RuntimeError):
    """No reply that can be read; ``status`` as in ``ProviderError``."""

    def __init__(self, status: int | str, said: str = ""):
        super().__init__(said)
        self.status = status


class ReplyPart(BaseModel):
    """Part of a reply: fields of exact types under the server's names. Other fields are dropped."""

    model_config = ConfigDict(strict=True, extra="ignore", alias_generator=to_camel)


class SdkProvider(ABC):
    """A provider that has its SDK's client as ``_client``, on ``_http`` and without retries.

    Args:
        config: whom to ask and how.
        package: the SDK's name in package registries.
        module: its name in Python.

    Raises:
        ValueError: no key.
        RuntimeError: the SDK is not installed.
    """

    _client: Any
    _http: Any

    def __init__(self, config: LiveConfig, package: str, module: str):
        try:
            self._sdk: Any = import_module(module)
        except ImportError as error:
            raise RuntimeError(
                f"vlm={config.kind} needs {package}; install it with: pip install 'needlehoop[vlm]'"
            ) from error
        self._config, self._key = config, config.read_key()

    def ask(self, request: Request) -> Reply:
        """See ``Provider``."""
        came: list[Reply | Exception] = []

        def attempt() -> None:
            try:
                came.append(self._send(request))
            except Exception as error:
                came.append(error)

        # On a thread, to bound the whole try: a server that sends a byte now and then never
        # exceeds the limit of a single wait.
        thread = threading.Thread(target=attempt, daemon=True)
        thread.start()
        thread.join(self._config.timeout)
        found = came[0] if came else WireError("timeout")
        if isinstance(found, Reply):
            return found
        # The SDK may have wrapped our own error in one of its own.
        error: BaseException | None = found
        while error is not None and not isinstance(error, WireError):
            error = error.__cause__ or error.__context__
        if error is None:
            raise found
        # Not chained: the SDK's own error may repeat the key.
        raise self._failure(error) from None

    def close(self) -> None:
        """See ``Provider``."""
        self._client.close()
        self._http.close()

    @abstractmethod
    def _send(self, request: Request) -> Reply:
        """One try with ``_client``."""

    def _failure(self, error: WireError) -> ProviderError:
        """In one line, without the key and without control characters."""
        timeout = f"no answer within {self._config.timeout:g} s"
        said = timeout if error.status == "timeout" else str(error)
        said = printable(re.sub(r"\s+", " ", strike(said, self._key))).strip()[:_LONGEST_ERROR]
        who = f"vlm={self._config.kind} ({self._config.model})"
        return ProviderError(f"{who}: {error.status}: {said}", error.status)


def careful(client: type[Any], seconds: float) -> Any:
    """A client for an SDK to speak through. It raises ``WireError`` where there is no reply.

    It follows no redirect, because a request's headers carry the key. It reads a reply piece by
    piece, and stops when the reply is too large or takes too long. It accepts no compression,
    because a few compressed bytes can hold gigabytes.

    Args:
        client: the ``Client`` of httpx, or of the package that the SDK has in its place.
        seconds: limit for connecting, for each piece of a reply, and for the whole reply.
    """
    names = {base.__module__.partition(".")[0] for base in client.__mro__ if base is not object}
    http = import_module(min(names & {"httpx", "httpx2"}))

    class Careful(client):
        """See ``careful``."""

        def send(self, request: Any, **options: Any) -> Any:
            until = time.monotonic() + seconds
            request.headers["Accept-Encoding"] = "identity"
            own = {**options, "stream": True, "follow_redirects": False}
            try:
                response = super().send(request, **own)
                body = _body(response, until)
            except http.TimeoutException as error:
                raise WireError("timeout") from error
            except http.ProtocolError as error:
                raise WireError("unreadable", "the reply is no HTTP, or broke off") from error
            except http.TransportError as error:
                raise WireError("unreachable", str(error)) from error
            if response.status_code != 200:
                raise WireError(response.status_code, _refusal(response, body))
            # The reply's own headers are dropped: none is needed, and the server chooses them.
            headers = {"Content-Type": "application/json"}
            return http.Response(200, headers=headers, text=_text(body), request=request)

    return Careful(timeout=seconds, follow_redirects=False)


def _body(response: Any, until: float) -> bytes:
    """A response's body, read piece by piece."""
    body = bytearray()
    try:
        if response.headers.get("Content-Encoding", "identity") != "identity":
            raise WireError("unreadable", "the reply is compressed, unasked")
        for piece in response.iter_raw():
            body += piece
            if len(body) > LARGEST:
                raise WireError("unreadable", f"the reply is larger than {LARGEST:,} bytes")
            if time.monotonic() > until:
                raise WireError("timeout")
    finally:
        response.close()
    return bytes(body)


def _text(body: bytes) -> str:
    try:
        return body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise WireError("unreadable", "the reply is no UTF-8") from error


def _refusal(response: Any, body: bytes) -> str:
    """What a server says of an error."""
    if response.is_redirect:
        return (
            f"it redirects to {response.headers.get('Location')!r}; the key goes nowhere unasked:"
            " give vlm.base_url if that is the server"
        )
    said = body.decode("utf-8", "replace")
    try:
        match parse_json(said):
            case {"error": {"message": str(message)}} | {"message": str(message)}:
                return message
    except UnreadableError:
        # The error is no JSON; its text is the message.
        pass
    return said


def read_reply(text: str, form: type[R], key: str | None) -> R:
    """The fields of a reply that are wanted.

    Args:
        text: of the reply.
        form: the wanted fields.
        key: replaced by ``***`` wherever the server repeats it.

    Raises:
        WireError: the text is no JSON, too deep, or of another form.
    """
    try:
        found = parse_json(text)
        # JSON can spell halves of characters (surrogates), which no file in UTF-8 can hold.
        json.dumps(found, ensure_ascii=False).encode()
        return form.model_validate(_struck(found, key))
    except UnreadableError as error:
        raise WireError("unreadable", f"the reply {error}") from error
    except UnicodeEncodeError as error:
        raise WireError("unreadable", "the reply has halves of characters") from error
    except ValidationError as error:
        (said,) = mistakes(error)
        raise WireError("unreadable", f"the reply is of another form: {said}") from error


def outcome(text: str, refusal: str | None, finish: str, is_cut: bool) -> tuple[str, str]:
    """A reply's ``outcome`` and ``detail``; ``finish`` is why it ended, in the server's words."""
    if refusal:
        return "refused", refusal
    if not text.strip():
        return "empty", finish
    return ("truncated", finish) if is_cut else ("answered", "")


def strike(text: str, key: str | None) -> str:
    """A text without the key, even if the text is JSON that spells the key with escapes."""
    if not key:
        return text
    plain = text.replace(key, "***")
    if "\\" not in plain:
        return plain
    try:
        found = parse_json(plain)
    except UnreadableError:
        return plain
    clean = _struck(found, key)
    return plain if clean == found else json.dumps(clean)


def _struck(value: Any, key: str | None) -> Any:
    """A JSON value in which the key is replaced."""
    if isinstance(value, str):
        return strike(value, key)
    if isinstance(value, dict):
        return {strike(name, key): _struck(inner, key) for name, inner in value.items()}
    return [_struck(inner, key) for inner in value] if isinstance(value, list) else value
