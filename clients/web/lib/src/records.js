// Generated from drape/engine/records.py by scripts/sync_wire.py. Do not edit.

// Of the whole table, a part of which follows: fields of records in their order, with their kinds.
export const LAYOUT = "39e8bb7cac793f67";
export const RECORDS = {
  Constants: { warp: "number", cross: "number", weft: "number", shear: "number", gap: "number", slack: "number", per_edge: "number", degenerate: "number", least: "number", reach: "number" },
  Creases: { corner: "int32s", stiffness: "numbers", cosine: "numbers", sine: "numbers" },
  Sheet: { constants: "Constants", vertex: "int32s", place: "int32s", fan_start: "int32s", fan_other: "int32s", fan_slope: "numbers", bend_start: "int32s", bend_other: "int32s", bend_value: "numbers", own: "numbers", creases: "Creases", crease_start: "int32s", crease_lane: "int32s", crease_member: "int32s", colour_start: "int32s" },
  PanelLevels: { row_start: "int32s", row_panel: "int32s", row: "int32s", column_start: "int32s", column: "int32s", panel: "int32s", left: "int32s", to: "int32s" },
  StiffnessFactor: { place: "int32s", column: "int32s", size: "int32s", start: "int32s", member: "int32s", entry: "int32s", value: "numbers", inverse: "numbers", levels: "PanelLevels" },
  SkinGraph: { neighbour: "int32s", reach_m2: "numbers", rest: "numbers" },
  SheetNeighbours: { start: "int32s", vertex: "int32s", square: "float32s", clusters: "int32s", other_start: "int32s", other: "int32s", bound: "bytes" },
  Tangles: { corner: "int32s", across: "int32s", start: "int32s", beside: "int32s" },
  FoldConstants: { sheet: "Sheet", factor: "StiffnessFactor", graph: "SkinGraph", neighbours: "SheetNeighbours", index: "int32s", friction: "number", hem: "int32s", tangles: "Tangles" },
  FineLevel: { sheet: "Sheet", near: "int32s", weight: "numbers", parent: "int32s", tangles: "Tangles" },
  Levels: { coarse: "FoldConstants", kept: "int32s", fine: "FineLevel" },
  FoldMemory: { network: "numbers", residual: "numbers", velocity: "numbers", grip: "numbers", own: "int32s", other: "int32s", fine: "numbers", turn: "count", step_s: "number" },
  FoldEffort: { steps: "count", settle: "count", cloth_contact: "count", clearance_m: "number" },
  Surroundings: { skin: "numbers", colliders: "float64s" },
  SwingRows: { moving: "count", node: "int32s", place: "int32s", start: "int32s", other: "int32s", slope: "numbers" },
  SwingMesh: { vertex: "int32s", mass_kg: "numbers", area_m2: "numbers", order: "int32s", start: "int32s", other: "int32s", slope: "numbers", weight_node: "int32s", weight: "numbers", pull_start: "int32s", pull_node: "int32s", pull: "numbers", rows: "SwingRows" },
  SwingConstants: { mesh: "SwingMesh", graph: "SkinGraph", index: "int32s", young_n_per_m: "number", damping_per_s: "number", held: "numbers" },
  SwingMemory: { network: "numbers", swung: "numbers", speed: "numbers", climb: "numbers", touched: "int32s", colliders: "float64s", origin: "float64s", time_s: "number", still_since_s: "float64s" },
  Layer: { weight: "numbers", bias: "numbers", slope: "number", tiles: "uint32s" },
  Weights: { mean: "numbers", inverse_deviation: "numbers", body: "Layer[]", from_body: "Layer", surroundings: "Layer", trunk: "Layer[]", heads: "Layer[]", first: "Layer[]", second: "Layer[]", basis: "numbers", basis_u: "numbers", basis_v: "numbers", logs: "numbers" },
  PatchRows: { first: "numbers", weights: "numbers", heaviest: "int32s", rotation: "numbers", centre: "numbers", scale: "numbers", slopes: "numbers", columns: "numbers", fit: "numbers", rest: "numbers", anchor: "uint32s", member: "int32s", tangent: "numbers", unit: "numbers", place: "numbers", sample: "int32s", bias: "numbers", region: "numbers", other: "bytes" },
  BodyFeed: { local: "numbers", rest: "numbers", betas: "numbers", motion: "numbers", skin_rows: "numbers", skin_bones: "int32s", skin_counts: "int32s" },
  PosedBody: { quaternion: "numbers", rotation: "numbers", translation: "numbers", place: "numbers", code: "numbers", betas: "numbers", skin: "numbers", region: "numbers" },
  PosedJets: { jet: "numbers", rotation: "numbers", centre: "numbers" },
  Tiles: { scale: "numbers", columns: "numbers", patch: "int32s", charts: "uint16s", wide_charts: "int32s" },
};
