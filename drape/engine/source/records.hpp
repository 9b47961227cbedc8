// Generated from drape/engine/records.py by `python -m drape.engine.records`: change the table there.
#pragma once
#include "arrays.hpp"

constexpr uint64_t RECORDS_HASH = 0xe75767ca87a4f71cu;

template <class T> struct Constants {
  double warp;
  double cross;
  double weft;
  double shear;
  double gap;
  double slack;
  double per_edge;
  double degenerate;
  double least;
  double reach;
};
static_assert(sizeof(Constants<float>) == 80, "Constants");

template <class T> struct Creases {
  Array<int32_t> corner;
  Array<T> stiffness;
  Array<T> cosine;
  Array<T> sine;
};
static_assert(sizeof(Creases<float>) == 64, "Creases");

template <class T> struct Sheet {
  Constants<T> constants;
  Array<int32_t> vertex;
  Array<int32_t> place;
  Array<int32_t> fan_start;
  Array<int32_t> fan_other;
  Array<T> fan_slope;
  Array<int32_t> bend_start;
  Array<int32_t> bend_other;
  Array<T> bend_value;
  Array<T> own;
  Creases<T> creases;
  Array<int32_t> crease_start;
  Array<int32_t> crease_lane;
  Array<int32_t> crease_member;
  Array<int32_t> colour_start;
};
static_assert(sizeof(Sheet<float>) == 352, "Sheet");

template <class T> struct SkinGraph {
  Array<int32_t> neighbour;
  Array<T> reach_m2;
  Array<T> rest;
};
static_assert(sizeof(SkinGraph<float>) == 48, "SkinGraph");

template <class T> struct SheetNeighbours {
  Array<int32_t> start;
  Array<int32_t> vertex;
  Array<float> square;
  Array<int32_t> clusters;
  Array<int32_t> other_start;
  Array<int32_t> other;
  Array<uint8_t> bound;
};
static_assert(sizeof(SheetNeighbours<float>) == 112, "SheetNeighbours");

template <class T> struct Tangles {
  Array<int32_t> corner;
  Array<int32_t> across;
  Array<int32_t> start;
  Array<int32_t> beside;
};
static_assert(sizeof(Tangles<float>) == 64, "Tangles");

template <class T> struct PanelLevels {
  Array<int32_t> row_start;
  Array<int32_t> row_panel;
  Array<int32_t> row;
  Array<int32_t> column_start;
  Array<int32_t> column;
  Array<int32_t> panel;
  Array<int32_t> left_start;
  Array<int32_t> left;
};
static_assert(sizeof(PanelLevels<float>) == 128, "PanelLevels");

template <class T> struct StiffnessFactor {
  Array<int32_t> place;
  Array<int32_t> column;
  Array<int32_t> size;
  Array<int32_t> start;
  Array<int32_t> member;
  Array<int32_t> entry;
  Array<T> value;
  Array<T> inverse;
  PanelLevels<T> levels;
};
static_assert(sizeof(StiffnessFactor<float>) == 256, "StiffnessFactor");

template <class T> struct FoldConstants {
  Sheet<T> sheet;
  StiffnessFactor<T> factor;
  SkinGraph<T> graph;
  SheetNeighbours<T> neighbours;
  Array<int32_t> index;
  double friction;
  Array<int32_t> hem;
  Tangles<T> tangles;
};
static_assert(sizeof(FoldConstants<float>) == 872, "FoldConstants");

template <class T> struct LaidCloth {
  Sheet<T> sheet;
  SkinGraph<T> graph;
  Array<int32_t> index;
};
static_assert(sizeof(LaidCloth<float>) == 416, "LaidCloth");

template <class T> struct FineLevel {
  Sheet<T> sheet;
  Array<int32_t> near;
  Array<T> weight;
  Array<int32_t> parent;
  Tangles<T> tangles;
};
static_assert(sizeof(FineLevel<float>) == 464, "FineLevel");

template <class T> struct Levels {
  FoldConstants<T> coarse;
  Array<int32_t> kept;
  FineLevel<T> fine;
};
static_assert(sizeof(Levels<float>) == 1352, "Levels");

template <class T> struct Surroundings {
  Array<T> skin;
  Array<double> colliders;
};
static_assert(sizeof(Surroundings<float>) == 32, "Surroundings");

template <class T> struct FoldEffort {
  int64_t steps;
  int64_t settle;
  int64_t cloth_contact;
  double clearance_m;
};
static_assert(sizeof(FoldEffort<float>) == 32, "FoldEffort");

template <class T> struct FoldMemory {
  Array<T> network;
  Array<T> residual;
  Array<T> velocity;
  Array<T> grip;
  Array<int32_t> own;
  Array<int32_t> other;
  Array<T> fine;
  int64_t turn;
  double step_s;
};
static_assert(sizeof(FoldMemory<float>) == 128, "FoldMemory");

template <class T> struct SwingRows {
  int64_t moving;
  Array<int32_t> node;
  Array<int32_t> place;
  Array<int32_t> start;
  Array<int32_t> other;
  Array<T> slope;
};
static_assert(sizeof(SwingRows<float>) == 88, "SwingRows");

template <class T> struct SwingMesh {
  Array<int32_t> vertex;
  Array<T> mass_kg;
  Array<T> area_m2;
  Array<int32_t> order;
  Array<int32_t> start;
  Array<int32_t> other;
  Array<T> slope;
  Array<int32_t> weight_node;
  Array<T> weight;
  Array<int32_t> pull_start;
  Array<int32_t> pull_node;
  Array<T> pull;
  SwingRows<T> rows;
};
static_assert(sizeof(SwingMesh<float>) == 280, "SwingMesh");

template <class T> struct SwingConstants {
  SwingMesh<T> mesh;
  SkinGraph<T> graph;
  Array<int32_t> index;
  double young_n_per_m;
  double damping_per_s;
  Array<T> held;
};
static_assert(sizeof(SwingConstants<float>) == 376, "SwingConstants");

template <class T> struct SwingMemory {
  Array<T> network;
  Array<T> swung;
  Array<T> speed;
  Array<T> climb;
  Array<int32_t> touched;
  Array<double> colliders;
  Array<double> origin;
  double time_s;
  Array<double> still_since_s;
};
static_assert(sizeof(SwingMemory<float>) == 136, "SwingMemory");

template <class T> struct Layer {
  Array<T> weight;
  Array<T> bias;
  double slope;
  Array<uint32_t> tiles;
};
static_assert(sizeof(Layer<float>) == 56, "Layer");

template <class T> struct Weights {
  Array<T> mean;
  Array<T> inverse_deviation;
  Array<Layer<T>> body;
  Layer<T> from_body;
  Layer<T> surroundings;
  Array<Layer<T>> trunk;
  Array<Layer<T>> heads;
  Array<Layer<T>> first;
  Array<Layer<T>> second;
  Array<T> basis;
  Array<T> basis_u;
  Array<T> basis_v;
  Array<T> logs;
};
static_assert(sizeof(Weights<float>) == 288, "Weights");

template <class T> struct MotionEncoder {
  Array<T> scale;
  Array<Layer<T>> joint;
  Array<Layer<T>> body;
  Layer<T> input;
  Layer<T> state;
  Layer<T> out;
  double decay_s;
  double offset;
};
static_assert(sizeof(MotionEncoder<float>) == 232, "MotionEncoder");

template <class T> struct KeptPoses {
  Array<Layer<T>> parts;
  Array<int32_t> counts;
  Array<int32_t> entry;
  Array<T> over;
};
static_assert(sizeof(KeptPoses<float>) == 64, "KeptPoses");

template <class T> struct PatchRows {
  Array<T> first;
  Array<T> weights;
  Array<int32_t> heaviest;
  Array<T> rotation;
  Array<T> centre;
  Array<T> scale;
  Array<T> slopes;
  Array<T> columns;
  Array<T> fit;
  Array<T> rest;
  Array<uint32_t> anchor;
  Array<int32_t> member;
  Array<T> tangent;
  Array<T> unit;
  Array<T> place;
  Array<int32_t> sample;
  Array<T> bias;
  Array<T> region;
  Array<uint8_t> other;
};
static_assert(sizeof(PatchRows<float>) == 304, "PatchRows");

template <class T> struct BodyFeed {
  Array<T> local;
  Array<T> rest;
  Array<T> betas;
  Array<T> motion;
  Array<T> skin_rows;
  Array<int32_t> skin_bones;
  Array<int32_t> skin_counts;
};
static_assert(sizeof(BodyFeed<float>) == 112, "BodyFeed");

template <class T> struct PosedBody {
  Array<T> quaternion;
  Array<T> rotation;
  Array<T> translation;
  Array<T> place;
  Array<T> code;
  Array<T> betas;
  Array<T> skin;
  Array<T> region;
};
static_assert(sizeof(PosedBody<float>) == 128, "PosedBody");

template <class T> struct Tiles {
  Array<T> scale;
  Array<T> columns;
  Array<int32_t> patch;
  Array<uint16_t> charts;
  Array<int32_t> wide_charts;
};
static_assert(sizeof(Tiles<float>) == 80, "Tiles");

template <class T> struct PosedJets {
  Array<T> jet;
  Array<T> rotation;
  Array<T> centre;
};
static_assert(sizeof(PosedJets<float>) == 48, "PosedJets");

template <class T> struct PushFeed {
  int64_t patches;
  Array<int32_t> block_vertex;
  Array<int32_t> vertex_slot;
  Array<int32_t> own_cluster;
  Array<T> own_bias;
  Array<uint8_t> other;
  Array<T> region_bias;
  Array<int32_t> patch_block;
  Array<T> patch_fit;
  Array<T> tile_basis;
  Array<int32_t> tile_patch;
  Array<int32_t> slot_charts;
};
static_assert(sizeof(PushFeed<float>) == 184, "PushFeed");

template <class T> struct FrameParts {
  Array<Weights<T>> weights;
  Array<KeptPoses<T>> kept;
  Array<PatchRows<T>> patches;
  Array<Tiles<T>> tiles;
  Array<SwingConstants<T>> swing;
  Array<FoldConstants<T>> cloth;
  Array<Levels<T>> levels;
  Array<FoldEffort<T>> effort;
  Array<FoldEffort<T>> novel_effort;
  int64_t passes;
  double share;
  double step_count;
};
static_assert(sizeof(FrameParts<float>) == 168, "FrameParts");

template <class T> struct FrameCall {
  Array<FrameParts<T>> parts;
  Array<BodyFeed<T>> body;
  int64_t lifts;
  Array<double> turns;
  Array<double> colliders;
  Array<SwingMemory<T>> swung_before;
  Array<SwingMemory<T>> swung;
  Array<FoldMemory<T>> folded_before;
  Array<FoldMemory<T>> folded;
  Array<T> vertices;
  Array<uint16_t> steps;
};
static_assert(sizeof(FrameCall<float>) == 168, "FrameCall");

template <class T> struct Triangles {
  Array<int32_t> corner;
  Array<T> inverse;
  Array<T> area;
  Array<int32_t> start;
  Array<int32_t> other;
  Array<T> slope;
};
static_assert(sizeof(Triangles<float>) == 96, "Triangles");

template <class T> struct Hinges {
  Array<int32_t> corner;
  Array<T> stiffness;
  Array<T> cosine;
  Array<T> sine;
  Array<int32_t> start;
  Array<int32_t> member;
};
static_assert(sizeof(Hinges<float>) == 96, "Hinges");

template <class T> struct Problem {
  Constants<T> constants;
  Triangles<T> triangles;
  Hinges<T> hinges;
  Array<T> weight_n;
  Array<T> contact_n_per_m;
};
static_assert(sizeof(Problem<float>) == 304, "Problem");

template <class T> struct Around {
  Array<T> point;
  Array<T> normal;
  Array<T> target;
  Array<T> target_n_per_m;
  Array<T> band;
  Array<T> band_n_per_m;
};
static_assert(sizeof(Around<float>) == 96, "Around");

template <class T> struct Pattern {
  Array<int32_t> start;
  Array<int32_t> column;
  Array<int32_t> diagonal;
  Array<int32_t> face;
  Array<int32_t> hinge;
};
static_assert(sizeof(Pattern<float>) == 80, "Pattern");

template <class T> struct Charts {
  Array<int32_t> patch;
  Array<T> weight;
};
static_assert(sizeof(Charts<float>) == 32, "Charts");

template <class T> struct System {
  Pattern<T> pattern;
  Array<T> blocks;
  Array<T> inverse;
  Charts<T> charts;
  Array<T> coarse;
};
static_assert(sizeof(System<float>) == 160, "System");
