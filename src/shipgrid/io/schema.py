"""JSON Schema of ship and scenario files, generated from the declarations, for editors.

`shipgrid check --schema ship` and `--schema scenario` print them. An editor then completes keys and shows their
meaning; bounds and units are checked by `shipgrid check` alone, which knows them.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from shipgrid.analysis.requirements import MEASURES, PAIRS, RULES
from shipgrid.automation.modes import MODES
from shipgrid.automation.power_management import RULES as PLANT_RULES
from shipgrid.equipment.declaration import EQUIPMENT, default_of, fields_of_kind, is_required
from shipgrid.equipment.ship import BUSBARS
from shipgrid.io.quantities import EXAMPLES
from shipgrid.io.scenario_file import STATES
from shipgrid.io.timeline_file import UNLIMITED, WITHOUT_A_TIME
from shipgrid.model.component import load_all, unit_of
from shipgrid.names import ITEM_NAME, LONGEST, PART_NAME

_DRAFT = "https://json-schema.org/draft/2020-12/schema"
_NAMES = {"pattern": f"^{ITEM_NAME.pattern}$"}
_NAME = {"type": "string", "minLength": 1, "maxLength": LONGEST}
_TIME = {"type": "string", "description": "a time with its unit [s]", "examples": ["10 s", "5 min"]}
_VALUE = {"type": ["string", "number", "boolean"], "description": "a quantity with its unit, a word, or true or false"}


def ship_schema() -> dict[str, Any]:
    """JSON Schema of a ship file."""
    load_all()
    items = [_kind(name, kind.cls) for name, kind in EQUIPMENT.items() if name != "hull"]
    properties: dict[str, Any] = {
        "schema": {"const": 1},
        "ship": {**_NAME, "description": "name of the ship"},
        "description": {"type": "string"},
        "buses": _named(_by_kind([_kind(name, cls) for name, cls in BUSBARS.items()])),
        "equipment": _named(_by_kind(items)),
        "parts": {
            "type": "object",
            "description": "buses by the name of a part, for a plant that is cut to be stepped on several cores",
            "propertyNames": {"pattern": f"^{PART_NAME.pattern}$"},
            "additionalProperties": {"type": "array", "items": {"type": "string"}, "minItems": 1},
            "minProperties": 2,
        },
    }
    if "hull" in EQUIPMENT:
        properties["hull"] = _object(EQUIPMENT["hull"].cls)
    return _root("ship", properties, ["schema", "ship", "buses", "equipment"])


def scenario_schema() -> dict[str, Any]:
    """JSON Schema of a scenario file; commands and signals are those of the ship, and not listed in it."""
    commands = {"type": "object", "additionalProperties": _VALUE}
    limit = {"type": ["string", "number"], "description": "in the unit of the signal"}
    condition = {
        "type": "object",
        "properties": {
            "signal": {"type": "string", "examples": ["bess_for.soc"]},
            "above": limit,
            "below": limit,
            "for": _TIME | {"description": "a time for which it has to hold"},
            "hysteresis": limit | {"description": "how far the signal has to be back before it may happen again"},
        },
        "required": ["signal"],
        "anyOf": [{"required": ["above"]}, {"required": ["below"]}],
        "additionalProperties": False,
    }
    name = {"type": "string", "description": "what other entries wait for (after), and the log names"}
    whole = {"anyOf": [{"type": "integer", "minimum": 1}, {"const": UNLIMITED}]}
    without_a_time = dict.fromkeys(WITHOUT_A_TIME, False)
    event = {
        "type": "object",
        "properties": {
            "name": name,
            "at": _TIME,
            "when": {
                "description": "a condition, or a list of conditions that all have to hold",
                "if": {"type": "array"},
                "then": {"items": condition, "minItems": 1},
                "else": condition,
            },
            "after": {
                "description": "name of an entry, or a list of names one of which has to have happened",
                "type": ["string", "array"],
                "items": {"type": "string"},
                "minItems": 1,
            },
            "delay": _TIME | {"description": "a time from then on"},
            "from": _TIME,
            "until": _TIME,
            "times": whole | {"description": "how often it may happen; once if left out"},
            "optional": {"type": "boolean", "description": "whether nobody minds if it never happens"},
            "mode": {"enum": list(MODES), "description": "operating mode: a set of commands; `set` goes before it"},
            "set": commands,
            "description": {"type": "string"},
        },
        "if": {"required": ["at"]},
        "then": {"properties": without_a_time, "anyOf": [{"required": ["set"]}, {"required": ["mode"]}]},
        "else": {
            "allOf": [
                {"anyOf": [{"required": ["when"]}, {"required": ["after"]}]},
                {"anyOf": [{"required": ["set"]}, {"required": ["mode"]}, {"required": ["name"]}]},
            ],
        },
        "additionalProperties": False,
    }
    pair = {"type": "array", "items": limit, "minItems": 2, "maxItems": 2}
    requirement = {
        "type": "object",
        "properties": {
            "name": {"type": "string"},
            "signal": {"type": "string", "examples": ["dc_for.v_dc"]},
            "minus": {"type": "string", "description": "a signal to be subtracted"},
            "description": {"type": "string"},
            **{measure: pair if measure in PAIRS else limit for measure in MEASURES},
            **dict.fromkeys(RULES, _TIME),
            "from": _TIME,
            "until": _TIME,
            "source": {
                "type": "string",
                "description": "where it comes from",
                "examples": ["contract, sec. 4", "ours"],
            },
        },
        "required": ["name", "signal"],
        "oneOf": [{"required": [measure]} for measure in MEASURES],
        "additionalProperties": False,
    }
    start = {
        "type": "object",
        "properties": {
            "state": {"enum": list(STATES)},
            "closed": {"type": "array", "items": {"type": "string"}, "description": "tie breakers that are closed"},
            "soc": {
                "type": "object",
                "additionalProperties": {"type": ["string", "number"], "examples": ["40 %"]},
                "description": "state of charge of batteries, where it is not the ship's",
            },
            "set": commands,
        },
        "required": ["state"],
        "additionalProperties": False,
    }
    properties = {
        "schema": {"const": 1},
        "scenario": {**_NAME, "description": "name of the scenario"},
        "description": {"type": "string"},
        "duration": _TIME,
        "step": _TIME,
        "start": start,
        "rules": {
            "type": "object",
            "description": "rules of power management that are in force",
            "properties": {name: _object(cls) for name, cls in PLANT_RULES.items()},
            "additionalProperties": False,
        },
        "timeline": {"type": "array", "items": event},
        "requirements": {"type": "array", "items": requirement},
    }
    return _root("scenario", properties, ["schema", "scenario", "duration", "start"])


def _root(what: str, properties: dict[str, Any], required: list[str]) -> dict[str, Any]:
    return {
        "$schema": _DRAFT,
        "title": f"shipgrid {what} file",
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _named(item: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "propertyNames": _NAMES, "additionalProperties": item}


def _by_kind(kinds: list[dict[str, Any]]) -> dict[str, Any]:
    """One of several kinds, told apart by `kind`, so that an editor's complaint is about the right one."""
    names = [kind["properties"]["kind"]["const"] for kind in kinds]
    branches = [
        {"if": {"properties": {"kind": {"const": name}}, "required": ["kind"]}, "then": kind}
        for name, kind in zip(names, kinds, strict=True)
    ]
    return {"type": "object", "properties": {"kind": {"enum": names}}, "required": ["kind"], "allOf": branches}


def _kind(name: str, cls: type) -> dict[str, Any]:
    schema = _object(cls)
    schema["properties"] = {"kind": {"const": name}, **schema["properties"]}
    return schema


def _object(cls: type) -> dict[str, Any]:
    fields = fields_of_kind(cls)
    return {
        "type": "object",
        "description": (cls.__doc__ or "").strip().splitlines()[0],
        "properties": {key: _field(field, hint) for key, (field, hint) in fields.items()},
        "required": [key for key, (field, _) in fields.items() if is_required(field)],
        "additionalProperties": False,
    }


def _field(field: dataclasses.Field[Any], hint: Any) -> dict[str, Any]:
    if "block" in field.metadata:
        return _object(field.metadata["block"])
    schema: dict[str, Any] = {"type": "string", "description": field.metadata.get("description", "")}
    unit = unit_of(hint)
    if "curve" in field.metadata:
        pair = {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2}
        pairs = {"type": "array", "items": pair, "minItems": 1}
        schema = {"description": schema["description"], "anyOf": [{"enum": list(field.metadata["choice"])}, pairs]}
    elif "choice" in field.metadata:
        schema["enum"] = list(field.metadata["choice"])
    elif unit is not None:
        bounds = field.metadata.get("bounds")
        schema["type"] = ["string", "number"] if unit == "1" else "string"
        schema["description"] = f"{bounds.description if bounds else field.name} [{unit}]" + (
            f", {bounds}" if bounds else ""
        )
        if unit in EXAMPLES:
            schema["examples"] = [EXAMPLES[unit]]
    elif hint is bool:
        schema["type"] = "boolean"
    if not is_required(field):
        default = default_of(field)
        schema["description"] += f"; default {default:g}" if isinstance(default, float) else f"; default {default}"
    return schema
