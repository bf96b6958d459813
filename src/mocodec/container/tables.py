"""Literal tables of the format: numbers on disk and what they stand for. Written down in docs/format.md.

Append only: an entry that has been released never moves, never changes, never goes.
"""

from __future__ import annotations

import numpy as np

CODEC_IDS = {1: "tempo", 2: "hou2014", 3: "liu2006", 4: "lossless", 5: "lien2006", 6: "bodycast"}
"""0 = a name follows."""

RATES: tuple[tuple[int, int], ...] = (
    (0, 1), (120, 1), (60, 1), (30, 1), (100, 1), (50, 1), (25, 1), (24, 1), (200, 1), (240, 1), (250, 1), (15, 1),
    (30000, 1001), (60000, 1001), (24000, 1001), (120000, 1001), (10, 1), (20, 1), (40, 1), (80, 1), (90, 1), (150, 1),
    (180, 1), (300, 1), (360, 1), (400, 1), (500, 1), (1000, 1), (2997, 100), (5994, 100), (12000, 1001), (5, 1),
)  # fmt: skip
"""Frame rates by number, as a fraction; 0 and numbers past the end of the table are spelled out."""

CMU_JOINTS = (
    "root lhipjoint lfemur ltibia lfoot ltoes rhipjoint rfemur rtibia rfoot rtoes lowerback upperback thorax "
    "lowerneck upperneck head lclavicle lhumerus lradius lwrist lhand lfingers lthumb rclavicle rhumerus rradius "
    "rwrist rhand rfingers rthumb"
)
CMU_MARKERS = (
    "LFWT RFWT LBWT RBWT LTHI LKNE LSHN LANK LHEE LMT5 LTOE RTHI RKNE RSHN RANK RHEE RMT5 RTOE CLAV STRN C7 T10 "
    "RBAC LFHD RFHD LBHD RBHD LSHO LUPA LELB LFRM LWRA LWRB LFIN RSHO RUPA RELB RFRM RWRA RWRB RFIN"
)
PLUG_IN_GAIT = (
    "LFHD RFHD LBHD RBHD C7 T10 CLAV STRN RBAK LSHO LUPA LELB LFRM LWRA LWRB LFIN RSHO RUPA RELB RFRM RWRA RWRB "
    "RFIN LASI RASI LPSI RPSI LTHI LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE"
)
SMPL = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot "
    "right_foot neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist "
    "right_wrist left_hand right_hand"
)
CMU_BVH = (
    "Hips LHipJoint LeftUpLeg LeftLeg LeftFoot LeftToeBase RHipJoint RightUpLeg RightLeg RightFoot RightToeBase "
    "LowerBack Spine Spine1 Neck Neck1 Head LeftShoulder LeftArm LeftForeArm LeftHand LeftFingerBase "
    "LeftHandIndex1 LThumb RightShoulder RightArm RightForeArm RightHand RightFingerBase RightHandIndex1 RThumb"
)
CMU_BVH_HIPS = (
    "Hips LHipJoint LeftHip LeftKnee LeftAnkle LeftToe RHipJoint RightHip RightKnee RightAnkle RightToe lowerback "
    "Chest Chest2 lowerneck Neck Head LeftCollar LeftShoulder LeftElbow LeftWrist lhand LFingers LThumb "
    "RightCollar RightShoulder RightElbow RightWrist rhand RFingers RThumb"
)

CMU_BVH_ENDS = (
    "Hips LHipJoint LeftUpLeg LeftLeg LeftFoot LeftToeBase LeftToeBase_end RHipJoint RightUpLeg RightLeg RightFoot "
    "RightToeBase RightToeBase_end LowerBack Spine Spine1 Neck Neck1 Head Head_end LeftShoulder LeftArm LeftForeArm "
    "LeftHand LeftFingerBase LeftHandIndex1 LeftHandIndex1_end LThumb LThumb_end RightShoulder RightArm RightForeArm "
    "RightHand RightFingerBase RightHandIndex1 RightHandIndex1_end RThumb RThumb_end"
)
CMU_BVH_HIPS_ENDS = (
    "Hips LHipJoint LeftHip LeftKnee LeftAnkle LeftToe LeftToe_end RHipJoint RightHip RightKnee RightAnkle RightToe "
    "RightToe_end lowerback Chest Chest2 lowerneck Neck Head Head_end LeftCollar LeftShoulder LeftElbow LeftWrist "
    "lhand LFingers LFingers_end LThumb LThumb_end RightCollar RightShoulder RightElbow RightWrist rhand RFingers "
    "RFingers_end RThumb RThumb_end"
)

VOCABULARY: tuple[str, ...] = tuple(
    " ".join(
        (
            CMU_JOINTS,  # 0: Carnegie Mellon, ASF/AMC, 31 joints
            CMU_MARKERS,  # 31: Carnegie Mellon, C3D, 41 markers
            SMPL,  # 72: SMPL, 24 joints; the first 22 also stand alone (SMPL-H body, AMASS, HumanML3D)
            CMU_BVH,  # 96: Carnegie Mellon as BVH in MotionBuilder's names, 31 joints
            CMU_BVH_HIPS,  # 127: the same in Biovision's names, 31 joints
            PLUG_IN_GAIT,  # 158: Vicon Plug-in Gait, full body, 39 markers
            # 197: Plug-in Gait's model outputs: segment origins and axes
            "CentreOfMass CentreOfMassFloor HEDO HEDA HEDL HEDP LCLO LCLA LCLL LCLP LFEO LFEA LFEL LFEP LFOO LFOA "
            "LFOL LFOP LHNO LHNA LHNL LHNP LHUO LHUA LHUL LHUP LRAO LRAA LRAL LRAP LTIO LTIA LTIL LTIP LTOO LTOA "
            "LTOL LTOP PELO PELA PELL PELP RCLO RCLA RCLL RCLP RFEO RFEA RFEL RFEP RFOO RFOA RFOL RFOP RHNO RHNA "
            "RHNL RHNP RHUO RHUA RHUL RHUP RRAO RRAA RRAL RRAP RTIO RTIA RTIL RTIP RTOO RTOA RTOL RTOP TRXO TRXA "
            "TRXL TRXP LHipAngles LKneeAngles LAnkleAngles LAbsAnkleAngle RHipAngles RKneeAngles RAnkleAngles "
            "RAbsAnkleAngle LShoulderAngles LElbowAngles LWristAngles RShoulderAngles RElbowAngles RWristAngles "
            "LNeckAngles RNeckAngles LSpineAngles RSpineAngles LHeadAngles RHeadAngles LThoraxAngles RThoraxAngles "
            "LPelvisAngles RPelvisAngles LFootProgressAngles RFootProgressAngles",
            # Helen Hayes and lower-body variants
            "SACR LHIP RHIP LMKNE RMKNE LMANK RMANK LKNM RKNM LMED RMED LMT1 RMT1 LTHU RTHU LTHD RTHD LTIU RTIU "
            "LTID RTID LPSIS RPSIS LASIS RASIS LBAK LWRI RWRI LTHM RTHM LARM RARM ARIEL NECK SACRUM",
            # BVH: Biovision, Poser and end sites
            "hip abdomen chest neck head leftEye rightEye rCollar rShldr rForeArm rHand rThumb1 rThumb2 rIndex1 "
            "rIndex2 rMid1 rMid2 rRing1 rRing2 rPinky1 rPinky2 lCollar lShldr lForeArm lHand lThumb1 lThumb2 "
            "lIndex1 lIndex2 lMid1 lMid2 lRing1 lRing2 lPinky1 lPinky2 rButtock rThigh rShin rFoot lButtock lThigh "
            "lShin lFoot",
            # FBX, Mixamo and game skeletons
            "Hips Spine Spine1 Spine2 Spine3 Neck Head HeadTop_End LeftShoulder LeftArm LeftForeArm LeftHand "
            "RightShoulder RightArm RightForeArm RightHand LeftUpLeg LeftLeg LeftFoot LeftToeBase LeftToe_End "
            "RightUpLeg RightLeg RightFoot RightToeBase RightToe_End",
            # Xsens MVN, 23 segments
            "Pelvis L5 L3 T12 T8 Neck Head RightShoulder RightUpperArm RightForearm RightHand LeftShoulder "
            "LeftUpperArm LeftForearm LeftHand RightUpperLeg RightLowerLeg RightFoot RightToe LeftUpperLeg "
            "LeftLowerLeg LeftFoot LeftToe",
            # OpenPose, COCO and Kinect
            "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow "
            "left_wrist right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle",
            CMU_BVH_ENDS,
            CMU_BVH_HIPS_ENDS,
            "SpineBase SpineMid Neck Head ShoulderLeft ElbowLeft WristLeft HandLeft ShoulderRight ElbowRight "
            "WristRight HandRight HipLeft KneeLeft AnkleLeft FootLeft HipRight KneeRight AnkleRight FootRight "
            "SpineShoulder HandTipLeft ThumbLeft HandTipRight ThumbRight",
        )
    ).split()
)
"""Names of markers and joints, the well-known sets one after the other, so that a set is one run of this table."""

NAME_DICTIONARY = (
    (
        "Marker_marker:Joint_joint_Point_ end Site_End_end_site_nub R.Epi.Med R.Epi.Lat R.Knee.Medial R.Ankle.Lateral "
        "R.Foot.Medial L.Foot.Lateral R.ASIS L.ASIS V.Sacral Sacral R.Heel L.Heel R.Toe R.Wrist.Rad R.Wrist.Uln "
        "L.Wrist R.Elbow L.Elbow R.Shoulder L.Shoulder R.Hip L.Hip R.GT L.GT R_FM1 R_FM5 L_FCC L_FAL L_TAM R_FLE L_FME "
        "L_TTC L_HME R_HLE r should l should r knee 1 l bar 1 r asis l asis r met l heel l mall r thigh sacrum "
        "left_right_upper_lower_Left_Right_LeftHandRightHandThumb1Index2Middle3Ring4Pinky "
        "mixamorig:Bip01_skeleton:Character1_" + " ".join(dict.fromkeys(VOCABULARY))
    )
    .replace(" ", "\n")
    .encode()
)
"""Preset dictionary for names that are not in the vocabulary; names are joined by newlines, so it is too."""

CMU_TREE = (
    -1, 0, 1, 2, 3, 4, 0, 6, 7, 8, 9, 0, 11, 12, 13, 14, 15, 13, 17, 18, 19, 20, 21, 20, 13, 24, 25, 26, 27, 28, 27,
)  # fmt: skip
SMPL_TREE = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
CMU_BVH_ENDS_TREE = (
    -1, 0, 1, 2, 3, 4, 5, 0, 7, 8, 9, 10, 11, 0, 13, 14, 15, 16, 17, 18, 15, 20, 21, 22, 23, 24, 25, 23, 27, 15, 29, 30,
    31, 32, 33, 34, 32, 36,
)  # fmt: skip

TREES: tuple[tuple[int, ...], ...] = ((), CMU_TREE, SMPL_TREE, SMPL_TREE[:22], CMU_BVH_ENDS_TREE)
"""Parents by number; 0 = spelled out. At most 7 can ever stand here."""

CMU_OFFSETS = (
    (0, 0, 0), (8491, -9975, 4278), (13927, -38264, 0), (14715, -40430, 0), (973, -2674, 11904), (0, 0, 6150),
    (-7839, -9975, 4278), (-14027, -38538, 0), (-14698, -40382, 0), (-1154, -3170, 12027), (0, 0, 6254),
    (-13, 11712, -768), (225, 11748, -134), (228, 11820, 226), (-194, 9437, 1033), (186, 9408, -1222),
    (85, 9687, -535), (18139, 6678, -1914), (28475, 0, 0), (19129, 0, 0), (9565, 0, 0), (3408, 0, 0),
    (2748, 0, 0), (2790, 0, 2790), (-17373, 6834, -1961), (-29445, 0, 0), (-19327, 0, 0), (-9664, 0, 0),
    (-3854, 0, 0), (-3107, 0, 0), (-3154, 0, 3154),
)  # fmt: skip
REFERENCE_OFFSETS: dict[int, tuple[tuple[int, int, int], ...]] = {1: CMU_OFFSETS}
"""A typical body for a tree, in steps of 10 µm: offsets are stored as departures from it. CMU: rounded mean of "
"nine subjects."""

CMU_RANGES = (
    ((-60, 70), (-70, 70), (-160, 20)), ((0, 0), (0, 0), (-10, 170)), ((-70, 20), (0, 0), (-45, 90)),
    ((0, 0), (0, 0), (-90, 20)), ((-70, 60), (-70, 70), (-160, 20)), ((-20, 70), (0, 0), (-45, 90)),
    ((-30, 30), (-30, 30), (-20, 45)), ((0, 20), (-20, 10), (0, 0)), ((-90, 90), (-90, 90), (-60, 90)),
    ((0, 0), (-180, 0), (0, 0)), ((-45, 45), (0, 0), (-90, 90)), ((0, 0), (0, 0), (0, 90)),
    ((-45, 45), (0, 0), (-45, 45)), ((-20, 0), (-10, 20), (0, 0)), ((-90, 90), (-90, 90), (-90, 60)),
    ((0, 0), (0, 0), (0, 0)),
)  # fmt: skip
CMU_FRAMES = (
    (0, 0, 0), (20, 0, 0), (20, 0, -90), (-20, 0, 0), (-20, 0, -90), (-90, -30, 180), (90, 90, 0), (0, 45, -90),
    (90, 30, 180), (-90, -90, 0), (0, -45, -90),
)  # fmt: skip
REFERENCE_LIMITS: dict[int, tuple[tuple[int, int, int], ...]] = {
    1: (
        (5, 15, 0), (5, 15, 0), (5, 0, 1), (5, 1, 1), (5, 2, 2), (5, 3, 2), (5, 15, 0), (5, 4, 3), (5, 1, 3), (5, 5, 4),
        (5, 3, 4), (5, 6, 0), (5, 6, 0), (5, 6, 0), (5, 6, 0), (5, 6, 0), (5, 6, 0), (5, 7, 0), (5, 8, 5), (5, 1, 5),
        (5, 9, 6), (5, 10, 6), (5, 11, 6), (5, 12, 7), (5, 13, 0), (5, 14, 8), (5, 1, 8), (5, 9, 9), (5, 10, 9),
        (5, 11, 9), (5, 12, 10),
    ),
}  # fmt: skip
"""Joint limits by number, which others are stored as departures from: of each joint the number of its order, its entry
in `CMU_RANGES` and its entry in `CMU_FRAMES`, both in degrees; the first joint's axes are unlimited. 1 = Carnegie
Mellon, ASF, 31 joints. 0 = none."""

WORDS: tuple[str, ...] = (
    "max_error", "mean_error", "ratio", "size", "components", "clip_frames", "quality", "tolerance", "step",
    "frequencies", "format", "units", "unit_m", "first_frame", "file", "axes", "up", "rotation_order", "order",
    "channels", "c3d", "trc", "bvh", "amc", "asf", "npz", "glb", "ply", "mm", "cm", "m", "in", "deg", "rad", "x",
    "y", "z", "analog", "events", "parameters", "label", "labels", "time_s", "description", "residuals",
    "camera_masks", "header", "subject", "context", "value", "values", "type", "name", "names", "joints",
    "residual_word", "root", "axis", "dof", "limits", "length", "mass", "angle", "version", "POINT", "ANALOG",
    "FORCE_PLATFORM", "EVENT", "TRIAL", "SUBJECTS", "EVENT_CONTEXT", "MANUFACTURER", "RATE", "USED", "FRAMES",
    "SCALE", "DATA_START", "LABELS", "DESCRIPTIONS", "UNITS", "X_SCREEN", "Y_SCREEN", "GEN_SCALE", "OFFSET",
    "GAIN", "FORMAT", "BITS", "CORNERS", "ORIGIN", "CHANNEL", "TYPE", "ZERO", "IS_STATIC", "ACTUAL_START_FIELD",
    "ACTUAL_END_FIELD", "CAMERA_RATE", "CONTEXTS", "ICON_IDS", "TIMES", "LABEL_PREFIXES", "DISPLAY_SETS",
    "Foot Strike", "Foot Off", "Left", "Right", "General", "comments", "documentation", "end_sites", "encoding",
    "double", "binary_little_endian", "ascii", "gender", "betas", "mocap_framerate", "poses", "trans", "offset",
    "scale", "data",
    "<i2", "<f4", "<f8", "up_guessed", "ASF", "parameter_notes", "parameters_locked",
)  # fmt: skip
"""Words of settings, source and extras that take one byte (number 128 + place in this table)."""

MORE_WORDS: tuple[str, ...] = (
    "notes", "time_of_frame_1", "chunk_seconds", "chunk_frames", "clips", "start_s", "animation", "skin",
)  # fmt: skip
"""Further words of settings, source and extras, which take two bytes (type 14, then the place in this table)."""

SOURCES: tuple[dict[str, object], ...] = (
    {},
    {"format": "c3d", "units": "mm", "unit_m": 0.001, "first_frame": 1},
    {"format": "c3d", "units": "mm", "unit_m": 0.001, "first_frame": 1, "up_guessed": True},
    {"format": "amc", "units": "ASF", "unit_m": 0.0254 / 0.45, "first_frame": 1},
    {"format": "trc", "units": "mm", "unit_m": 0.001, "first_frame": 1},
    {"format": "trc", "units": "mm", "unit_m": 0.001, "first_frame": 1, "up_guessed": True},
    {"format": "c3d", "units": "m", "unit_m": 1.0, "first_frame": 1},
    {"format": "bvh", "units": "cm", "unit_m": 0.01},
    {"format": "bvh", "units": "ASF", "unit_m": 0.0254 / 0.45},
)
"""Usual sources: a source is stored as the number of one of these, with its differences."""

C3D_DESCRIPTIONS = [
    "Left front waist", "Right front waist", "Left back waist", "Right back waist", "Left thigh", "Left knee",
    "Left shin", "Left ankle", "Left heel", "Left metatarsal five", "Left toe", "Right Thigh", "Right knee",
    "Right shin offset", "Right ankle", "Right heel", "Right metatarsal five", "Right toe", "Clavicle", "Sternum",
    "Back of neck", "Upper back", "Right back offset marker", "Left front head", "Right front head",
    "Left back head", "Right back head", "Left shoulder", "Left upper arm", "Left elbow", "Left forearm",
    "Left wrist bar thumb side", "Left wrist bar pinkie side", "Left hand", "Right shoulder", "Right upper arm",
    "Right elbow", "Right forearm", "Right wrist bar thumb side", "Right wrist bar pinkie side", "Right hand",
]  # fmt: skip


def i2(first: int, *more: int) -> np.ndarray:
    return np.array([first, *more] if more else first, "<i2")


def f4(number: float) -> np.ndarray:
    return np.array(number, "<f4")


def typical_extras() -> dict[str, object]:
    """Parameters as Vicon's programs write them into a C3D: their bytes prime deflate for every tree of values."""
    return {
        "analog": None,
        "comments": ["Force Plate", "Voltage", "EMG", "Fx1", "Fy1", "Fz1", "Mx1", "My1", "Mz1", "N", "Nmm", "V"],
        "parameters": {
            "ANALYSIS": {"USED": i2(0), "NAMES": [], "SUBJECTS": [], "CONTEXTS": [], "UNITS": []},
            "MANUFACTURER": {"COMPANY": "Vicon", "SOFTWARE": "Vicon Nexus", "VERSION_LABEL": "1.8.5"},
            "FORCE_PLATFORM": {"USED": i2(0), "TYPE": i2(2), "ZERO": i2(1, 0)},
            "ANALOG": {"GEN_SCALE": f4(1), "GAIN": [], "SCALE": f4(1), "OFFSET": i2(0), "UNITS": []},
            "TRIAL": {
                "ACTUAL_START_FIELD": i2(1, 0),
                "ACTUAL_END_FIELD": i2(500, 0),
                "CAMERA_RATE": f4(120),
                "VIDEO_RATE_DIVIDER": i2(1),
                "X_DIRECTION": i2(1),
                "Y_DIRECTION": i2(3),
                "Z_DIRECTION": i2(5),
            },
            "SUBJECTS": {
                "IS_STATIC": i2(0),
                "USES_PREFIXES": i2(1),
                "NAMES": ["Male"],
                "LABEL_PREFIXES": ["Male:"],
                "USED": i2(1),
                "MARKER_SETS": ["HumanRTKm.mkr", "PlugInGait"],
                "DISPLAY_SETS": ["Autolabel", *[""] * 40],
                "MODELS": ["FoxedUp.mod", *[""] * 40],
                "MODEL_PARAMS": ["FoxedUp.mp", *[""] * 40],
            },
            "POINT": {
                "SCALE": f4(-0.05),
                "MOVIE_DELAY": f4(0),
                "X_SCREEN": "+X",
                "Y_SCREEN": "+Z",
                "ANGLE_UNITS": "deg",
                "DESCRIPTIONS": C3D_DESCRIPTIONS,
            },
            "TIMECODE": {},
            "EVENT_CONTEXT": {
                "USED": i2(3),
                "ICON_IDS": i2(0, 0, 0),
                "LABELS": ["Left", "Right", "General"],
                "DESCRIPTIONS": ["Left side", "Right side", "For other events"],
                "COLOURS": np.diag([192, 192, 192]).astype("<i2"),
            },
            "EVENT": {},
        },
    }
