"""Replies of servers that may be hostile: how they arrive, and what is read of them."""

from __future__ import annotations

import json
import time
from importlib import import_module
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from needlehoop.runs.reading import UnreadableError, parse_json

R = TypeVar("R", bound="ReplyPart")

Count = Annotated[int, Field(ge=0, le=2**53)]

LARGEST = 1_000_000
"""Bytes of a reply, at most; a usual one has about 5,000. Reading stops there."""

_LONGEST_ERROR = 1_000
"""Characters of a server's error that are passed on."""


class ReplyError(UnreadableError):
    """A reply that can't be read. The message is ours, not the server's."""


class ReplyPart(BaseModel):
    """Part of a reply: fields of exact types under the server's names. Other fields are dropped."""

    model_config = ConfigDict(strict=True, extra="ignore", alias_generator=to_camel)


def careful(client: type[Any], seconds: float) -> Any:
    """A client for an SDK to speak through.

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
            try:
                response = super().send(
                    request, **{**options, "stream": True, "follow_redirects": False}
                )
                body = _body(response, until)
            except http.ProtocolError as error:
                raise ReplyError("the reply is no HTTP, or broke off") from error
            if response.status_code != 200:
                body = _refusal(response, body)
            elif not _is_text(body):
                raise ReplyError("the reply is no UTF-8")
            # The reply's own headers are dropped: none is needed, and the server chooses them.
            return http.Response(
                response.status_code,
                headers={"Content-Type": "application/json"},
                content=body,
                request=request,
            )

    return Careful(timeout=seconds, follow_redirects=False)


def _refusal(response: Any, body: bytes) -> bytes:
    """An error's message, in a form that every SDK reads."""
    said = body.decode("utf-8", "replace")
    try:
        match parse_json(said):
            case {"error": {"message": str(message)}} | {"message": str(message)}:
                said = message
    except UnreadableError:
        # The error is no JSON; its text is the message.
        pass
    if response.is_redirect:
        said = (
            f"it redirects to {response.headers.get('Location')!r}; the key goes nowhere unasked:"
            " give vlm.base_url if that is the server"
        )
    error = {"message": said[:_LONGEST_ERROR], "code": response.status_code}
    return json.dumps({"error": error}).encode()


def _is_text(body: bytes) -> bool:
    try:
        body.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _body(response: Any, until: float) -> bytes:
    """A response's body, read piece by piece."""
    body = bytearray()
    try:
        if response.headers.get("Content-Encoding", "identity") != "identity":
            raise ReplyError("the reply is compressed, unasked")
        for piece in response.iter_raw():
            body += piece
            if len(body) > LARGEST:
                raise ReplyError(f"the reply is larger than {LARGEST:,} bytes")
            if time.monotonic() > until:
                raise TimeoutError
    finally:
        response.close()
    return bytes(body)


def read_reply(body: bytes, form: type[R], key: str | None) -> R:
    """The fields of a reply that are wanted.

    Args:
        body: the reply's bytes.
        form: the wanted fields.
        key: replaced by ``***`` wherever the server repeats it.

    Raises:
        ReplyError: the body is not UTF-8, no JSON, too deep, or of another form.
    """
    try:
        found = parse_json(body.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ReplyError("the reply is no UTF-8") from error
    except UnreadableError as error:
        raise ReplyError(f"the reply {error}") from error
    try:
        # JSON can spell halves of characters (surrogates), which no file in UTF-8 can hold.
        json.dumps(found, ensure_ascii=False).encode()
        return form.model_validate(_struck(found, key))
    except UnicodeEncodeError as error:
        raise ReplyError("the reply has halves of characters") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "all of it"
        raise ReplyError(f"the reply is of another form: {where}: {first['msg']}") from error


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
