"""The tunnelling controller as its equations say it, in Python: what the runtime is compared with.

Nothing here imports piezoid. Histories are lists that grow; modes are words; bits are collected
by name and summed at the end.
"""

import math

BITS = {
    "bad measurement": 4,
    "limited": 8,
    "stuck": 16,
    "voltage": 32,
    "lost": 128,
    "retracted": 256,
    "approaching": 2048,
    "no current": 4096,
    "wrong sign": 8192,
    "latched": 16384,
}


class Tip:
    """One axis from rest at ``volts`` with ``current_A``; ``p`` holds the runtime's parameters."""

    def __init__(self, p, volts, current_A):
        self.p, self.volts, self.last, self.mode = p, volts, current_A, "controls"
        self.equal, self.has_moved, self.moved_from = 0, False, volts
        self.waited, self.back, self.trips, self.since = 0, 0, 0, 0
        self.in_contact, self.contact_V, self.cause, self.climb = 0, 0.0, set(), 0.0
        self.rest(self.log(current_A))

    def log(self, current_A):
        p = self.p
        kept = min(max(current_A, p["current_floor_A"]), p["current_ceiling_A"])
        return math.log(kept / p["current_reference_A"])

    def rest(self, y):
        self.y, self.r, self.moves, self.excess = [y] * 40, [y] * 40, [0.0] * 40, [0.0] * 40

    def put(self, wanted):
        low, high = self.p["voltage_minimum_V"], self.p["voltage_maximum_V"]
        self.volts = min(max(wanted, low), high)
        if self.volts != wanted:
            self.said.add("voltage")

    def is_stuck(self, current_A):
        p = self.p
        if p["stuck_samples"] == 0:
            return False
        if current_A != self.last:
            self.equal, self.has_moved, self.moved_from = 0, False, self.volts
            return False
        self.equal = min(self.equal + 1, p["stuck_samples"])
        self.has_moved |= abs(self.volts - self.moved_from) >= p["stuck_voltage_V"]
        return self.has_moved and self.equal >= p["stuck_samples"]

    def judge(self, current_A, wanted):
        """What drives the tip back: a set of words; None: it waits."""
        p, why = self.p, set()
        if not math.isfinite(current_A):
            why = {"bad measurement"}
        else:
            stuck = self.is_stuck(current_A) and current_A > p["stuck_current_A"]
            self.last = current_A
            if (
                current_A < -p["current_floor_A"]
                and self.log(-current_A) >= wanted - p["contact_log"]
            ):
                why = {"wrong sign"}
        self.said |= why
        if why:
            self.waited += 1
            return why if self.waited > p["bad_samples"] else None
        self.waited = 0
        why |= {"stuck"} if stuck else set()
        why |= {"limited"} if current_A >= p["current_ceiling_A"] else set()
        self.said |= why
        if current_A < p["current_floor_A"]:
            self.said.add("lost")
        return why

    def flee(self, why, for_good):
        p = self.p
        self.since, self.cause, self.waited = 0, set(why), 0
        self.said |= why | {"retracted"}
        self.mode, self.back = "approaches", p["retract_samples"] * 2**self.trips - 1
        self.trips += 1
        above = self.volts > p["retract_voltage_V"]
        end = p["retract_voltage_V"] if above else p["voltage_minimum_V"]
        if for_good or 0 < p["trip_limit"] <= self.trips:
            self.mode = "latched"
            self.said.add("latched")
            self.volts = end
        else:
            step = p["retract_step_V"]
            self.volts = max(end, self.volts - step) if step > 0 else end

    def step(self, reference_A, current_A, reset):
        p, self.said = self.p, set()
        wanted = self.log(reference_A)
        why = self.judge(current_A, wanted)
        if reset:
            self.trips = 0
            if self.mode == "latched":
                self.mode, self.back, self.in_contact = "approaches", 0, 0
                self.equal, self.has_moved, self.moved_from = 0, False, self.volts
        if self.since < p["trip_samples"]:
            self.since += 1
        else:
            self.trips = 0
        if self.mode == "latched" or self.back > 0:
            self.said |= {"retracted"}
            if self.mode == "latched":
                self.said |= {"latched"} | self.cause
            else:
                self.back -= 1
            self.waited = 0
        elif why:
            self.flee(why, False)
        elif why is not None:
            self.go(wanted, self.log(current_A), current_A < p["current_floor_A"])
        return self.volts, sum(BITS[word] for word in self.said)

    def go(self, wanted, y, lost):
        p = self.p
        there = not lost and y >= wanted - p["contact_log"]
        repeats = p["stuck_samples"] > 0 and self.equal >= 2
        if self.mode == "approaches" and there:
            self.mode, self.climb = "controls", min(y - wanted, 0.0)
            self.rest(y)
        elif self.mode == "controls" and (lost or y < wanted + self.climb - 2 * p["contact_log"]):
            self.mode = "approaches"
        if there:
            if self.in_contact == 0:
                self.contact_V = self.volts
            elif not repeats:
                self.contact_V = max(self.volts, self.contact_V - p["approach_step_V"])
            self.in_contact = min(self.in_contact + 1, p["contact_samples"])
        elif self.in_contact < p["contact_samples"]:
            self.in_contact = 0
        at_end = self.volts >= p["voltage_maximum_V"]
        known = p["search_voltage_V"] > 0 and self.in_contact >= p["contact_samples"]
        if (self.mode == "approaches" and at_end) or (
            known and self.volts > self.contact_V + p["search_voltage_V"]
        ):
            self.flee({"no current"}, at_end)
        elif self.mode == "approaches":
            self.said.add("approaching")
            self.put(self.volts + p["approach_step_V"])
        else:
            self.control(wanted, y, repeats)

    def control(self, wanted, y, repeats):
        p, before = self.p, self.volts
        self.climb = min(self.climb + p["approach_log_step"], 0.0)
        self.y.insert(0, y)
        self.r.insert(0, wanted + self.climb)
        change = sum(t * r for t, r in zip(p["rst_T_V"], self.r, strict=False))
        change -= sum(r * y for r, y in zip(p["rst_R_V"], self.y, strict=False))
        change -= sum(s * u for s, u in zip(p["rst_S"][1:], self.moves, strict=False))
        asked = before + change
        held = repeats and change > p["approach_step_V"]
        self.put(before + p["approach_step_V"] if held else asked)
        self.moves.insert(0, self.volts - before)
