"""Blender add-on: File > Import > Motion (.mocz), File > Export > Motion (.mocz).

Recordings with rotations become an armature, other recordings an empty for each point. Gaps remain: an empty is hidden
while its point is missing.
"""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from . import from_blender, to_blender

EXTENSIONS = "*.mocz;*.c3d;*.trc;*.bvh;*.amc;*.npz;*.npy;*.sto;*.mot;*.csv"


class ImportMotion(bpy.types.Operator, ImportHelper):
    """Import a recording: an armature if it has rotations, otherwise an empty for each point"""

    bl_idname = "import_anim.mocz"
    bl_label = "Import motion"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads this class attribute

    filename_ext = ".mocz"
    filter_glob: StringProperty(default=EXTENSIONS, options={"HIDDEN"})
    as_empties: BoolProperty(name="Empties", description="An empty for each point, even with rotations", default=False)
    set_scene: BoolProperty(name="Set rate and range", description="Set the scene's frame rate and range", default=True)
    scale: FloatProperty(name="Scale", description="Blender units a metre", default=1.0, min=1e-4, max=1e4)

    def execute(self, context: bpy.types.Context) -> set[str]:
        import mocodec

        try:
            motion = mocodec.read(self.filepath, mocodec.Motion)
            name = bpy.path.display_name_from_filepath(self.filepath)
            made = to_blender.add(context, motion, name, self.scale, self.as_empties, self.set_scene)
        except (mocodec.MocodecError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, made)
        return {"FINISHED"}


class ExportMotion(bpy.types.Operator, ExportHelper):
    """Export the active armature, or the selected empties, over the scene's frame range"""

    bl_idname = "export_anim.mocz"
    bl_label = "Export motion"

    filename_ext = ".mocz"
    filter_glob: StringProperty(default="*.mocz", options={"HIDDEN"})
    target: EnumProperty(
        name="Promise",
        items=[
            ("max_error", "Largest error", "No joint of any frame is farther off"),
            ("mean_error", "Mean error", "The mean over all joints and frames"),
            ("lossless", "Exact", "Every number as it is"),
        ],
        default="max_error",
    )
    error: FloatProperty(name="Error", description="Metres", default=0.001, min=1e-6, max=1.0, subtype="DISTANCE")
    scale: FloatProperty(name="Scale", description="Blender units a metre", default=1.0, min=1e-4, max=1e4)

    def execute(self, context: bpy.types.Context) -> set[str]:
        import mocodec

        try:
            motion = from_blender.motion_of(context, self.scale)
            if self.target == "lossless":
                mocodec.write(self.filepath, motion, codec="lossless")
            else:
                mocodec.write(self.filepath, motion, **{self.target: self.error})
            with mocodec.open(self.filepath) as opened:
                ratio = opened.info["ratio"]
        except (mocodec.MocodecError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(motion)} frames of {motion.points} points, {ratio:.0f} : 1")
        return {"FINISHED"}


def draw_import(menu: bpy.types.Menu, _: bpy.types.Context) -> None:
    menu.layout.operator(ImportMotion.bl_idname, text="Motion (.mocz, .c3d, .trc, .amc, …)")


def draw_export(menu: bpy.types.Menu, _: bpy.types.Context) -> None:
    menu.layout.operator(ExportMotion.bl_idname, text="Motion (.mocz)")


def register() -> None:
    bpy.utils.register_class(ImportMotion)
    bpy.utils.register_class(ExportMotion)
    bpy.types.TOPBAR_MT_file_import.append(draw_import)
    bpy.types.TOPBAR_MT_file_export.append(draw_export)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_export.remove(draw_export)
    bpy.types.TOPBAR_MT_file_import.remove(draw_import)
    bpy.utils.unregister_class(ExportMotion)
    bpy.utils.unregister_class(ImportMotion)
