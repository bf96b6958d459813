"""Literal tables of the format: numbers on disk and what they stand for. Written down in docs/format.md.

Append only: an entry that has been released never moves, never changes, never goes.
"""

from __future__ import annotations

CODEC_IDS = {1: "tempo", 2: "hou2014", 3: "liu2006", 4: "lossless", 5: "lien2006"}
"""0 = a name follows."""

RATES: tuple[tuple[int, int], ...] = (
    (0, 1), (120, 1), (60, 1), (30, 1), (100, 1), (50, 1), (25, 1), (24, 1), (200, 1), (240, 1), (250, 1), (15, 1),
    (30000, 1001), (60000, 1001), (24000, 1001), (120000, 1001), (10, 1), (20, 1), (40, 1), (80, 1), (90, 1), (150, 1),
    (180, 1), (300, 1), (360, 1), (400, 1), (500, 1), (1000, 1), (2997, 100), (5994, 100), (12000, 1001), (5, 1),
)  # fmt: skip
"""Frame rates by number, as a fraction; 0 and numbers past the end of the table are spelled out."""

CMU_JOINTS = (
    "root lhipjoint lfemur ltibia lfoot ltoes rhipjoint rfemur rtibia rfoot rtoes lowerback upperback thorax lowerneck "
    "upperneck head lclavicle lhumerus lradius lwrist lhand lfingers lthumb rclavicle rhumerus rradius rwrist rhand "
    "rfingers rthumb"
)
CMU_MARKERS = (
    "LFWT RFWT LBWT RBWT LTHI LKNE LSHN LANK LHEE LMT5 LTOE RTHI RKNE RSHN RANK RHEE RMT5 RTOE CLAV STRN C7 T10 RBAC "
    "LFHD RFHD LBHD RBHD LSHO LUPA LELB LFRM LWRA LWRB LFIN RSHO RUPA RELB RFRM RWRA RWRB RFIN"
)
PLUG_IN_GAIT = (
    "LFHD RFHD LBHD RBHD C7 T10 CLAV STRN RBAK LSHO LUPA LELB LFRM LWRA LWRB LFIN RSHO RUPA RELB RFRM RWRA RWRB RFIN "
    "LASI RASI LPSI RPSI LTHI LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE"
)
SMPL = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot "
    "neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist "
    "left_hand right_hand"
)
CMU_BVH = (
    "Hips LHipJoint LeftUpLeg LeftLeg LeftFoot LeftToeBase RHipJoint RightUpLeg RightLeg RightFoot RightToeBase LowerBack "
    "Spine Spine1 Neck Neck1 Head LeftShoulder LeftArm LeftForeArm LeftHand LeftFingerBase LeftHandIndex1 LThumb "
    "RightShoulder RightArm RightForeArm RightHand RightFingerBase RightHandIndex1 RThumb"
)
CMU_BVH_HIPS = (
    "Hips LHipJoint LeftHip LeftKnee LeftAnkle LeftToe RHipJoint RightHip RightKnee RightAnkle RightToe lowerback Chest "
    "Chest2 lowerneck Neck Head LeftCollar LeftShoulder LeftElbow LeftWrist lhand LFingers LThumb RightCollar "
    "RightShoulder RightElbow RightWrist rhand RFingers RThumb"
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
            "CentreOfMass CentreOfMassFloor HEDO HEDA HEDL HEDP LCLO LCLA LCLL LCLP LFEO LFEA LFEL LFEP LFOO LFOA LFOL "
            "LFOP LHNO LHNA LHNL LHNP LHUO LHUA LHUL LHUP LRAO LRAA LRAL LRAP LTIO LTIA LTIL LTIP LTOO LTOA LTOL LTOP PELO "
            "PELA PELL PELP RCLO RCLA RCLL RCLP RFEO RFEA RFEL RFEP RFOO RFOA RFOL RFOP RHNO RHNA RHNL RHNP RHUO RHUA RHUL "
            "RHUP RRAO RRAA RRAL RRAP RTIO RTIA RTIL RTIP RTOO RTOA RTOL RTOP TRXO TRXA TRXL TRXP "
            "LHipAngles LKneeAngles LAnkleAngles LAbsAnkleAngle RHipAngles RKneeAngles RAnkleAngles RAbsAnkleAngle "
            "LShoulderAngles LElbowAngles LWristAngles RShoulderAngles RElbowAngles RWristAngles LNeckAngles RNeckAngles "
            "LSpineAngles RSpineAngles LHeadAngles RHeadAngles LThoraxAngles RThoraxAngles LPelvisAngles RPelvisAngles "
            "LFootProgressAngles RFootProgressAngles",
            # Helen Hayes and lower-body variants
            "SACR LHIP RHIP LMKNE RMKNE LMANK RMANK LKNM RKNM LMED RMED LMT1 RMT1 LTHU RTHU LTHD RTHD LTIU RTIU LTID RTID "
            "LPSIS RPSIS LASIS RASIS LBAK LWRI RWRI LTHM RTHM LARM RARM ARIEL NECK SACRUM",
            # BVH: Biovision, Poser and end sites
            "hip abdomen chest neck head leftEye rightEye rCollar rShldr rForeArm rHand rThumb1 rThumb2 rIndex1 rIndex2 "
            "rMid1 rMid2 rRing1 rRing2 rPinky1 rPinky2 lCollar lShldr lForeArm lHand lThumb1 lThumb2 lIndex1 lIndex2 lMid1 "
            "lMid2 lRing1 lRing2 lPinky1 lPinky2 rButtock rThigh rShin rFoot lButtock lThigh lShin lFoot",
            # FBX, Mixamo and game skeletons
            "Hips Spine Spine1 Spine2 Spine3 Neck Head HeadTop_End LeftShoulder LeftArm LeftForeArm LeftHand "
            "RightShoulder RightArm RightForeArm RightHand LeftUpLeg LeftLeg LeftFoot LeftToeBase LeftToe_End RightUpLeg "
            "RightLeg RightFoot RightToeBase RightToe_End",
            # Xsens MVN, 23 segments
            "Pelvis L5 L3 T12 T8 Neck Head RightShoulder RightUpperArm RightForearm RightHand LeftShoulder LeftUpperArm "
            "LeftForearm LeftHand RightUpperLeg RightLowerLeg RightFoot RightToe LeftUpperLeg LeftLowerLeg LeftFoot LeftToe",
            # OpenPose, COCO and Kinect
            "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow left_wrist "
            "right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle",
            "SpineBase SpineMid Neck Head ShoulderLeft ElbowLeft WristLeft HandLeft ShoulderRight ElbowRight WristRight "
            "HandRight HipLeft KneeLeft AnkleLeft FootLeft HipRight KneeRight AnkleRight FootRight SpineShoulder HandTipLeft "
            "ThumbLeft HandTipRight ThumbRight",
        )
    ).split()
)
"""Names of markers and joints, the well-known sets one after the other, so that a set is one run of this table."""

NAME_DICTIONARY = (
    "Marker_marker:Joint_joint_Point_ end Site_End_end_site_nub R.Epi.Med R.Epi.Lat R.Knee.Medial R.Ankle.Lateral R.Foot"
    ".Medial L.Foot.Lateral R.ASIS L.ASIS V.Sacral Sacral R.Heel L.Heel R.Toe R.Wrist.Rad R.Wrist.Uln L.Wrist R.Elbow "
    "L.Elbow R.Shoulder L.Shoulder R.Hip L.Hip R.GT L.GT R_FM1 R_FM5 L_FCC L_FAL L_TAM R_FLE L_FME L_TTC L_HME R_HLE r should"
    " l should r knee 1 l bar 1 r asis l asis r met l heel l mall r thigh sacrum left_right_upper_lower_Left_Right_LeftHand"
    "RightHandThumb1Index2Middle3Ring4Pinky mixamorig:Bip01_skeleton:Character1_"
    + " ".join(dict.fromkeys(VOCABULARY))
).replace(" ", "\n").encode()
"""Preset dictionary for names that are not in the vocabulary; names are joined by newlines, so it is too."""

CMU_TREE = (
    -1, 0, 1, 2, 3, 4, 0, 6, 7, 8, 9, 0, 11, 12, 13, 14, 15, 13, 17, 18, 19, 20, 21, 20, 13, 24, 25, 26, 27, 28, 27,
)  # fmt: skip
SMPL_TREE = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)

TREES: tuple[tuple[int, ...], ...] = ((), CMU_TREE, SMPL_TREE, SMPL_TREE[:22])
"""Parents by number; 0 = spelled out. At most 7 can ever stand here."""

CMU_OFFSETS = (
    (0, 0, 0), (8491, -9975, 4278), (13927, -38264, 0), (14715, -40430, 0), (973, -2674, 11904), (0, 0, 6150),
    (-7839, -9975, 4278), (-14027, -38538, 0), (-14698, -40382, 0), (-1154, -3170, 12027), (0, 0, 6254),
    (-13, 11712, -768), (225, 11748, -134), (228, 11820, 226), (-194, 9437, 1033), (186, 9408, -1222), (85, 9687, -535),
    (18139, 6678, -1914), (28475, 0, 0), (19129, 0, 0), (9565, 0, 0), (3408, 0, 0), (2748, 0, 0), (2790, 0, 2790),
    (-17373, 6834, -1961), (-29445, 0, 0), (-19327, 0, 0), (-9664, 0, 0), (-3854, 0, 0), (-3107, 0, 0), (-3154, 0, 3154),
)  # fmt: skip
REFERENCE_OFFSETS: dict[int, tuple[tuple[int, int, int], ...]] = {1: CMU_OFFSETS}
"""A typical body for a tree, in steps of 10 µm: offsets are stored as departures from it. CMU: rounded mean of nine subjects."""

WORDS: tuple[str, ...] = (
    "max_error", "mean_error", "ratio", "size", "components", "clip_frames", "quality", "tolerance", "step", "frequencies",
    "format", "units", "unit_m", "first_frame", "file", "axes", "up", "rotation_order", "order", "channels",
    "c3d", "trc", "bvh", "amc", "asf", "npz", "glb", "ply", "mm", "cm", "m", "in", "deg", "rad", "x", "y", "z",
    "analog", "events", "parameters", "label", "labels", "time_s", "description", "residuals", "camera_masks", "header",
    "subject", "context", "value", "values", "type", "name", "names", "joints", "hierarchy", "root", "axis", "dof", "limits",
    "length", "mass", "angle", "version", "POINT", "ANALOG", "FORCE_PLATFORM", "EVENT", "TRIAL", "SUBJECTS", "PROCESSING",
    "MANUFACTURER", "RATE", "USED", "FRAMES", "SCALE", "DATA_START", "LABELS", "DESCRIPTIONS", "UNITS", "X_SCREEN",
    "Y_SCREEN", "GEN_SCALE", "OFFSET", "GAIN", "FORMAT", "BITS", "CORNERS", "ORIGIN", "CHANNEL", "TYPE", "ZERO", "CAL_MATRIX",
    "ACTUAL_START_FIELD", "ACTUAL_END_FIELD", "CAMERA_RATE", "CONTEXTS", "ICON_IDS", "TIMES", "LABEL_PREFIXES", "GENERIC_FLAGS",
    "Foot Strike", "Foot Off", "Left", "Right", "General", "comments", "documentation", "end_sites", "encoding", "double",
    "binary_little_endian", "ascii", "gender", "betas", "mocap_framerate", "poses", "trans", "offset", "scale", "data",
)  # fmt: skip
"""Words of settings, source and extras that take one byte (number 128 + place in this table)."""
