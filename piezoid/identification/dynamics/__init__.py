"""Linear dynamics: periodic recordings -> frequency response -> modes, delay and their intervals.

    PeriodicData --estimate_response--> FrequencyResponse --fit_dynamics--> LinearDynamics
                                                           choose_structure  (by held-out error)

Read first: ``frequency_response`` (what is measured), then ``modal`` (what is kept of it).
"""
