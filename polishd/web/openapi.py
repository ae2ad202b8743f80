"""The OpenAPI document, from the table of routes."""

from __future__ import annotations

import re
from typing import Any

from polishd import __version__
from polishd.web.api import MAPS, MOST_NUMBER
from polishd.web.routes import ROUTES, ApiRoute

ERROR = {"type": "object", "properties": {"ok": {"type": "boolean"}, "error": {"type": "string"}}}
NUMBER = {"type": "integer", "minimum": 0, "maximum": MOST_NUMBER}
TYPES = {"string": {"type": "string"}, "array": {"type": "array", "items": NUMBER}}
REFUSALS = {
    "400": "the request is wrong, and says how",
    "401": "nobody is signed in",
    "403": "the role does not suffice, or the request is forged",
    "404": "there is none",
    "405": "that cannot be done there",
    "408": "the body came too slowly",
    "409": "the daemon refuses it, and says why",
    "413": "the body is too large",
    "421": "asked for by a name that is none of this server's",
    "429": "too many requests",
    "502": "the daemon answered what cannot be understood",
    "503": "no daemon runs, or the journal is damaged",
    "504": "the daemon does not answer",
}


def document() -> dict[str, Any]:
    """Of version 3.1."""
    paths: dict[str, dict[str, Any]] = {}
    for route in ROUTES:
        paths.setdefault(open_path(route.path), {})[route.method.lower()] = _operation(route)
    token = {"type": "object", "properties": {"token": {"type": "string"}}, "required": ["token"]}
    sign_in = {"summary": "sign in: a cookie for a token", "security": [], "requestBody": _body(token)}
    paths["/api/session"]["post"] = {**sign_in, "responses": _responses()}
    paths["/api/openapi.json"] = {"get": {"summary": "this document", "security": [], "responses": _responses()}}
    schemes = {
        "token": {"type": "http", "scheme": "bearer"},
        "cookie": {"type": "apiKey", "in": "cookie", "name": "polishd"},
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "polishd", "version": __version__, "description": "Hold and stop are no emergency stop."},
        "paths": paths,
        "components": {"securitySchemes": schemes},
        "security": [{"token": []}, {"cookie": []}],
    }


def open_path(path: str) -> str:
    """As OpenAPI writes it."""
    return re.sub(r":int}", "}", path)


def _operation(route: ApiRoute) -> dict[str, Any]:
    names = re.findall(r"{(\w+)(:int)?}", route.path)
    found: dict[str, Any] = {
        "summary": route.what,
        "description": f"Needs the role {route.role.value}, or more.",
        "responses": _responses(stream=route.path == "/api/events", order=route.method == "POST"),
        "parameters": [
            {"name": name, "in": "path", "required": True, "schema": NUMBER if number else {"enum": list(MAPS)}}
            for name, number in names
        ],
    }
    if route.path == "/api/journal":
        found["parameters"].append({"name": "before", "in": "query", "schema": NUMBER})
    if route.fields:
        properties = {name.rstrip("?"): TYPES[kind] for name, kind in route.fields}
        required = [name for name, _ in route.fields if not name.endswith("?")]
        schema = {"type": "object", "properties": properties, **({"required": required} if required else {})}
        # to stand still is never wrong: whatever the body is, the order is taken
        found["requestBody"] = _body({} if route.exempt else schema, required=bool(required))
    return found


def _body(schema: dict[str, Any], *, required: bool = True) -> dict[str, Any]:
    return {"required": required, "content": {"application/json": {"schema": schema}}}


def _responses(*, stream: bool = False, order: bool = False) -> dict[str, Any]:
    kind = "text/event-stream" if stream else "application/json"
    good = {"description": "done", "content": {kind: {"schema": {"type": "string" if stream else "object"}}}}
    error = {"application/json": {"schema": ERROR}}
    later = {"202": {**good, "description": "not obeyed yet; it stands"}} if order else {}
    return {"200": good, **later, **{code: {"description": why, "content": error} for code, why in REFUSALS.items()}}
