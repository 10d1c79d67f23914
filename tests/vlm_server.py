"""A server on this machine that speaks Gemini's and OpenAI's protocols."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

KEY = "sk-very-secret-0123456789"

Answer = str | dict[str, Any]


@dataclass
class Server:
    """What the server says, in order, and what it was asked.

    An entry of ``script`` is a text (the model's answer), a dict with ``status`` and
    ``body`` (an HTTP error or any reply, text or bytes), ``sleep``, ``headers``, ``drip``
    (seconds between the bytes of the body), or ``finish``/``refusal`` with ``text``. Past
    its end, ``otherwise`` answers from the request's JSON schema.
    """

    script: list[Answer] = field(default_factory=list)
    otherwise: Callable[[dict[str, Any], str], str] | None = None
    requests: list[dict[str, Any]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)
    url: str = ""
    sent: int = 0

    def answer(self, path: str, body: dict[str, Any]) -> tuple[int, Any, dict[str, Any]]:
        self.requests.append(body)
        self.paths.append(path)
        schema = schema_of(body)
        entry = self.script.pop(0) if self.script else None
        if entry is None:
            assert self.otherwise is not None
            entry = self.otherwise(schema, last_text(body))
        said = {"text": entry} if isinstance(entry, str) else entry
        time.sleep(said.get("sleep", 0))
        if "body" in said or "status" in said:
            text = said.get("body", '{"error": {"message": "no"}}')
            return said.get("status", 200), text, said
        reply = gemini_reply if "generateContent" in path else openai_reply
        return 200, json.dumps(reply(said)), said


def schema_of(body: dict[str, Any]) -> dict[str, Any]:
    if "contents" in body:
        config = body["generationConfig"]
        return config["responseJsonSchema"]
    return body["response_format"]["json_schema"]["schema"]


def last_text(body: dict[str, Any]) -> str:
    if "contents" in body:
        return "".join(part.get("text", "") for part in body["contents"][-1]["parts"])
    return "".join(part.get("text", "") for part in body["messages"][-1]["content"])


def gemini_reply(said: dict[str, Any]) -> dict[str, Any]:
    usage = {"promptTokenCount": 100, "candidatesTokenCount": 10, "thoughtsTokenCount": 5}
    reply: dict[str, Any] = {"modelVersion": "gemini-test-001", "usageMetadata": usage}
    if "refusal" in said:
        return {**reply, "promptFeedback": {"blockReason": said["refusal"]}}
    content = {"role": "model", "parts": [{"text": said["text"]}]}
    finish = said.get("finish", "STOP")
    return {**reply, "candidates": [{"content": content, "finishReason": finish, "index": 0}]}


def openai_reply(said: dict[str, Any]) -> dict[str, Any]:
    message = {
        "role": "assistant",
        "content": said.get("text"),
        "refusal": said.get("refusal"),
    }
    finish = said.get("finish", "stop")
    return {
        "id": "1",
        "object": "chat.completion",
        "created": 0,
        "model": "test-model-001",
        "choices": [{"index": 0, "message": message, "finish_reason": finish}],
        "usage": {"prompt_tokens": 100, "completion_tokens": 15, "total_tokens": 115},
    }


def by_schema(schema: dict[str, Any], prompt: str = "") -> str:
    """A valid answer to any question: the first of each choice, rankings in their order."""
    return json.dumps(_value(schema, schema.get("$defs", {})))


def _value(schema: dict[str, Any], defs: dict[str, Any]) -> Any:
    if "$ref" in schema:
        return _value(defs[schema["$ref"].rpartition("/")[2]], defs)
    if "enum" in schema:
        return schema["enum"][0]
    if schema["type"] == "object":
        return {name: _value(inner, defs) for name, inner in schema["properties"].items()}
    if schema["type"] == "array" and schema["items"].get("type") == "number":
        (place,) = (one for one in defs.values() if "name" in one["properties"])
        return [0.75] * (len(place["properties"]["name"]["enum"]) - 1)
    if schema["type"] == "array":
        place = defs[schema["items"]["$ref"].rpartition("/")[2]]
        names = place["properties"]["name"]["enum"]
        return [{"name": name, "reason": f"because of {name}"} for name in names]
    return "so be it"


def live(server: Server) -> list[str]:
    """The words of a command that asks it as Gemini."""
    return ["vlm=gemini", f"vlm.base_url={server.url}", "vlm.first_wait=0", "size=16"]


@contextmanager
def serve() -> Iterator[Server]:
    """A server on a free port, for as long as the context lasts."""
    server = Server(otherwise=by_schema)

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            server.headers.append(dict(self.headers))
            status, text, said = server.answer(self.path, body)
            data = text.encode() if isinstance(text, str) else text
            try:
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(data)))
                for name, value in said.get("headers", {}).items():
                    self.send_header(name, value)
                self.end_headers()
                for place in range(0, len(data), 1 if "drip" in said else 65_536):
                    time.sleep(said.get("drip", 0))
                    self.wfile.write(data[place : place + (1 if "drip" in said else 65_536)])
                    server.sent += 65_536
            except ConnectionError:
                pass  # The client did not wait.

        def log_message(self, *_: object) -> None:
            pass

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.url = f"http://127.0.0.1:{http.server_port}"
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        http.shutdown()
        thread.join()
        http.server_close()
