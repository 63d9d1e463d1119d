"""Reference implementation of the tunnelling controller in Python, without piezoid.

Histories are growing lists, modes are words, and status bits are collected by name.
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
    """Axis at rest at ``volts`` with ``current_A``; ``p`` has the parameters of the runtime."""

    def __init__(self, p, volts, current_A):
        self.p, self.volts, self.last, self.mode = p, volts, current_A, "controls"
        self.equal, self.has_moved, self.moved_from = 0, False, volts
        self.waited, self.retract_left, self.trips, self.samples_since_trip = 0, 0, 0, 0
        self.in_contact, self.contact_V, self.cause, self.climb = 0, 0.0, set(), 0.0
        self.settle(self.log(current_A))

    def log(self, current_A):
        p = self.p
        current = min(max(current_A, p["current_floor_A"]), p["current_ceiling_A"])
        return math.log(current / p["current_reference_A"])

    def settle(self, y):
        self.y, self.r, self.moves, self.excess = [y] * 40, [y] * 40, [0.0] * 40, [0.0] * 40

    def put(self, target):
        low, high = self.p["voltage_minimum_V"], self.p["voltage_maximum_V"]
        self.volts = min(max(target, low), high)
        if self.volts != target:
            self.reported.add("voltage")

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

    def judge(self, current_A, target):
        """Return the causes of a retraction, or None while the controller waits."""
        p, causes = self.p, set()
        if not math.isfinite(current_A):
            causes = {"bad measurement"}
        else:
            stuck = self.is_stuck(current_A) and current_A > p["stuck_current_A"]
            self.last = current_A
            if (
                current_A < -p["current_floor_A"]
                and self.log(-current_A) >= target - p["contact_log"]
            ):
                causes = {"wrong sign"}
        self.reported |= causes
        if causes:
            self.waited += 1
            return causes if self.waited > p["bad_samples"] else None
        self.waited = 0
        causes |= {"stuck"} if stuck else set()
        causes |= {"limited"} if current_A >= p["current_ceiling_A"] else set()
        self.reported |= causes
        if current_A < p["current_floor_A"]:
            self.reported.add("lost")
        return causes

    def flee(self, causes, for_good):
        p = self.p
        self.samples_since_trip, self.cause, self.waited = 0, set(causes), 0
        self.reported |= causes | {"retracted"}
        self.mode, self.retract_left = "approaches", p["retract_samples"] * 2**self.trips - 1
        self.trips += 1
        above = self.volts > p["retract_voltage_V"]
        end = p["retract_voltage_V"] if above else p["voltage_minimum_V"]
        if for_good or 0 < p["trip_limit"] <= self.trips:
            self.mode = "latched"
            self.reported.add("latched")
            self.volts = end
        else:
            step = p["retract_step_V"]
            self.volts = max(end, self.volts - step) if step > 0 else end

    def step(self, reference_A, current_A, reset):
        p, self.reported = self.p, set()
        target = self.log(reference_A)
        causes = self.judge(current_A, target)
        if reset:
            self.trips = 0
            if self.mode == "latched":
                self.mode, self.retract_left, self.in_contact = "approaches", 0, 0
                self.equal, self.has_moved, self.moved_from = 0, False, self.volts
        if self.samples_since_trip < p["trip_samples"]:
            self.samples_since_trip += 1
        else:
            self.trips = 0
        if self.mode == "latched" or self.retract_left > 0:
            self.reported |= {"retracted"}
            if self.mode == "latched":
                self.reported |= {"latched"} | self.cause
            else:
                self.retract_left -= 1
            self.waited = 0
        elif causes:
            self.flee(causes, False)
        elif causes is not None:
            self.go(target, self.log(current_A), current_A < p["current_floor_A"])
        return self.volts, sum(BITS[word] for word in self.reported)

    def go(self, target, y, is_lost):
        p = self.p
        is_in_contact = not is_lost and y >= target - p["contact_log"]
        repeats = p["stuck_samples"] > 0 and self.equal >= 2
        if self.mode == "approaches" and is_in_contact:
            self.mode, self.climb = "controls", min(y - target, 0.0)
            self.settle(y)
        elif self.mode == "controls" and (
            is_lost or y < target + self.climb - 2 * p["contact_log"]
        ):
            self.mode = "approaches"
        if is_in_contact:
            if self.in_contact == 0:
                self.contact_V = self.volts
            elif not repeats:
                self.contact_V = max(self.volts, self.contact_V - p["approach_step_V"])
            self.in_contact = min(self.in_contact + 1, p["contact_samples"])
        elif self.in_contact < p["contact_samples"]:
            self.in_contact = 0
        at_end = self.volts >= p["voltage_maximum_V"]
        has_contact_voltage = p["search_voltage_V"] > 0 and self.in_contact >= p["contact_samples"]
        if (self.mode == "approaches" and at_end) or (
            has_contact_voltage and self.volts > self.contact_V + p["search_voltage_V"]
        ):
            self.flee({"no current"}, at_end)
        elif self.mode == "approaches":
            self.reported.add("approaching")
            self.put(self.volts + p["approach_step_V"])
        else:
            self.control(target, y, repeats)

    def control(self, target, y, repeats):
        p, previous_V = self.p, self.volts
        self.climb = min(self.climb + p["approach_log_step"], 0.0)
        self.y.insert(0, y)
        self.r.insert(0, target + self.climb)
        change_V = sum(t * r for t, r in zip(p["rst_T_V"], self.r, strict=False))
        change_V -= sum(r * y for r, y in zip(p["rst_R_V"], self.y, strict=False))
        change_V -= sum(s * u for s, u in zip(p["rst_S"][1:], self.moves, strict=False))
        requested_V = previous_V + change_V
        is_stuck = repeats and change_V > p["approach_step_V"]
        self.put(previous_V + p["approach_step_V"] if is_stuck else requested_V)
        self.moves.insert(0, self.volts - previous_V)
