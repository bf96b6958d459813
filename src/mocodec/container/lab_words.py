"""Words of laboratories: labels, units and descriptions that gait programs, force plates and EMG write into C3D files.

Their bytes prime deflate for the extras of such files, before those of `tables.typical_extras`.
"""

from __future__ import annotations

SIDES = "LR"
JOINTS_WITH_FORCES = ("Ankle", "Knee", "Hip", "Waist", "Neck", "Shoulder", "Elbow", "Wrist")
ANGLES = (
    "HipAngles", "KneeAngles", "AnkleAngles", "AbsAnkleAngle", "PelvisAngles", "FootProgressAngles", "NeckAngles",
    "SpineAngles", "ThoraxAngles", "HeadAngles", "ShoulderAngles", "ElbowAngles", "WristAngles",
)  # fmt: skip
MUSCLES = (
    "Tibialis Anterior", "Gastrocnemius", "Soleus", "Rectus Femoris", "Vastus Lateralis", "Vastus Medialis",
    "Biceps Femoris", "Semitendinosus", "Gluteus Medius", "Gluteus Maximus", "Biceps", "Triceps", "Deltoid",
    "Trapezius", "Pectoralis", "Latissimus Dorsi",
)  # fmt: skip


def lab_extras() -> dict[str, object]:
    """A tree of the words, rarest first, since deflate reaches near bytes with fewer bits. Never change it."""
    return {
        "emg": [
            *(f"Channel_{i:02d}" for i in range(1, 33)),
            *(f"Channel {i}" for i in range(1, 17)),
            *(f"Analog EMG::Voltage [10,{i}]" for i in range(1, 9)),
            *(f"Delsys Trigno EMG 2.0::Sensor {i} [11,1]" for i in range(1, 17)),
            *(f"Sensor {i}.{kind}{i}" for i in range(1, 17) for kind in ("EMG", "IM EMG", "ACCX", "ACCY", "ACCZ")),
            *(f"EMG_{i}" for i in range(1, 17)),
            *(f"EMG{i}" for i in range(1, 17)),
            *(f"EMG {i}" for i in range(1, 17)),
            *(f"{side} {muscle}" for muscle in MUSCLES for side in SIDES),
        ],
        "plates": [
            *(f"Kistler Force Plate 2.0.0.0::{axis}{n} [{n},{i}]" for n in (1, 2)
              for i, axis in enumerate(("Force.Fx", "Force.Fy", "Force.Fz", "Moment.Mx", "Moment.My", "Moment.Mz"), 1)),
            *(f"AMTI Force Plate::Force.F{axis}{n} [{n},{i}]" for n in (1, 2) for i, axis in enumerate("xyz", 1)),
            *(f"FP{n}_{axis}" for n in (1, 2) for axis in ("FX", "FY", "FZ", "MX", "MY", "MZ")),
            *(f"{axis}{n}" for n in (1, 2, 3, 4) for axis in ("FX", "FY", "FZ", "MX", "MY", "MZ")),
            *(f"Raw.Pin {i}" for i in range(1, 65)),
            *(f"Electric Potential.{i}" for i in range(1, 17)),
            *(f"Voltage.{i}" for i in range(1, 17)),
            *(f"{axis}{n}" for n in (1, 2, 3, 4)
              for axis in ("FX12", "FX34", "FY14", "FY23", "FZ1", "FZ2", "FZ3", "FZ4")),
            *(f"{axis}{n}" for n in (1, 2, 3, 4, 5)
              for axis in ("Force.Fx", "Force.Fy", "Force.Fz", "Moment.Mx", "Moment.My", "Moment.Mz")),
        ],
        "units": ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * 4 + ["N"] * 20 + ["Nmm"] * 20 + ["V"] * 40 + ["", ""] * 40,
        "parameters": {
            "MANUFACTURER": {"COMPANY": "Qualisys", "SOFTWARE": "Qualisys Track Manager", "VERSION": [2, 17, 0]},
            "BTS": "SMART-Analyzer",
            "EVT": "Cortex Motion Analysis EvaRT OptiTrack Motive NaturalPoint C-Motion Visual3D THEIA3D",
            "SEG": {"MARKER_DIAMETER": 14, "DATA_LIMITS": [], "ACC_FACTOR": 50, "NOISE_FACTOR": 10,
                    "RESIDUAL_ERROR_FACTOR": 2, "INTERSECTION_LIMIT": 50},
            "EVENT": {
                "USED": 4, "CONTEXTS": ["Left", "Right", "Left", "Right"],
                "LABELS": ["Foot Strike", "Foot Off", "Foot Strike", "Foot Off"],
                "DESCRIPTIONS": ["The instant the heel strikes the ground", "The instant the toe leaves the ground"],
                "SUBJECTS": ["Subject", "Subject"], "TIMES": [], "ICON_IDS": [], "GENERIC_FLAGS": [],
            },
            "PROCESSING": {
                "Bodymass": 1, "Height": 1, "InterAsisDistance": 1, "HeadOffset": 1,
                **{side + name: 1 for name in (
                    "LegLength", "AsisTrocanterDistance", "KneeWidth", "AnkleWidth", "TibialTorsion", "SoleDelta",
                    "ThighRotation", "ShankRotation", "StaticPlantFlex", "StaticRotOff", "AnkleAbAdd", "ShoulderOffset",
                    "ElbowWidth", "WristWidth", "HandThickness",
                ) for side in SIDES},
            },
            "ANALYSIS": {
                "NAMES": [
                    "Cadence", "Walking Speed", "Stride Time", "Step Time", "Opposite Foot Off",
                    "Opposite Foot Contact", "Foot Off", "Single Support", "Double Support", "Stride Length",
                    "Step Length", "Step Width", "Limp Index",
                ],
                "DESCRIPTIONS": [], "SUBJECTS": [], "CONTEXTS": [], "VALUES": [],
                "UNITS": ["steps/min", "m/s", "s", "s", "%", "%", "%", "s", "s", "m", "m"],
            },
            "SUBJECTS": {
                "MARKER_SETS": ["PlugInGait FullBody Ai", "PlugInGait LowerBody Ai", "CGM2.3", "Oxford Foot Model"],
            },
            "FORCE_PLATFORM": {
                "USED": 2, "TYPE": [], "ZERO": [], "CORNERS": [], "ORIGIN": [], "CHANNEL": [], "CAL_MATRIX": [],
            },
            "POINT": {
                "MOVIE_DELAY": 0, "MOVIE_ID": "", "X_SCREEN": "+X", "Y_SCREEN": "+Z", "ANGLE_UNITS": "deg",
                "FORCE_UNITS": "N", "MOMENT_UNITS": "Nmm", "POWER_UNITS": "W", "MODELED_MARKER_UNITS": "mm",
                "SCALAR_UNITS": "mm", "REACTION_UNITS": "", "TYPE_GROUPS": [], "LABELS2": [], "DESCRIPTIONS2": [],
            },
        },
        "model_outputs": {
            "signals": {
                "ANGLES": [side + name for side in SIDES for name in ANGLES],
                "REACTIONS": [],
                "FORCES": [f"{side}{name}" for name in ("GroundReactionForce", "NormalisedGRF") for side in SIDES]
                + [f"{side}{joint}Force" for joint in JOINTS_WITH_FORCES for side in SIDES],
                "MOMENTS": [f"{side}GroundReactionMoment" for side in SIDES]
                + [f"{side}{joint}Moment" for joint in JOINTS_WITH_FORCES for side in SIDES],
                "POWERS": [f"{side}{joint}Power" for joint in JOINTS_WITH_FORCES for side in SIDES] + ["W"] * 20,
            },
            "columns": None,
            "words": None,
        },
    }  # fmt: skip
