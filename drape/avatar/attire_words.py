"""What names of meshes, nodes, materials and pictures say of a character's parts: one table of words.

A name falls into words at capitals, digits and marks; a word of the table also counts inside of a longer one if it has
``LONG`` letters, or if it is in a script that writes words together. Sources: VRoid Studio's materials
(``N00_007_01_Tops_01_CLOTH``), Ready Player Me's meshes (``Wolf3D_Outfit_Top``), MakeHuman's clothes (``fedora01``),
Mixamo's characters (``Ch08_Hoodie``, ``Alpha_Surface``), Character Creator's (``CC_Base_Body``), KayKit's nodes
(``1H_Axe``), MikuMikuDance's materials in Japanese, and plain dictionaries for the other languages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Literal, get_args

Kind = Literal[
    "skin",
    "face",
    "hair",
    "hat",
    "top",
    "outer",
    "trousers",
    "skirt",
    "dress",
    "underwear",
    "gloves",
    "shoes",
    "carried",
]
KINDS: tuple[str, ...] = get_args(Kind)
CLOTH = "cloth"  # Such words say that something is worn, and not what.
DOLL = "doll"  # Such words name figures without clothes, in whatever colours.
GENERAL = (CLOTH, DOLL, "skin")
LONG = 4

WORDS: dict[str, str] = {
    "skin": "skin flesh nude naked bare 肌 皮膚 皮肤 身体皮肤 피부 кожа piel",
    "face": "face eye eyes iris brow eyebrow eyelash eyelashes lash mouth teeth tooth tongue lip lips nose ear ears"
    " beard moustache mustache sclera pupil 顔 目 瞳 眉 口 歯 舌 まつげ 睫 脸 眼 嘴 牙 얼굴 눈 눈썹 입 лицо глаз глаза"
    " рот зубы брови cara ojo ojos boca dientes cejas",
    "hair": "hair fringe bangs ponytail ahoge braid afro bob wig 髪 前髪 後髪 ヘア 头发 頭髮 刘海 머리카락 헤어 волосы"
    " прическа pelo cabello peluca",
    "hat": "hat cap helmet helm hood headwear beanie fedora crown tiara headdress 帽 帽子 ヘルメット 兜 头盔 모자 헬멧"
    " шляпа шапка шлем sombrero gorra casco",
    "top": "top tops shirt tshirt tee blouse sweater sweat sweatshirt hoodie pullover jumper jersey tank camisole vest"
    " sleeve sleeves polo bodice corset トップス シャツ 上着 セーター ブラウス 上衣 衬衫 毛衣 상의 셔츠 스웨터 블라우스"
    " рубашка футболка свитер блузка кофта camisa camiseta blusa sueter",
    "outer": "jacket coat cape cloak poncho cardigan blazer mantle robe ジャケット コート マント 外套 夹克 大衣 披风"
    " 재킷 코트 망토 куртка пальто плащ chaqueta abrigo capa",
    "trousers": "trousers trouser pants pant jeans shorts bottom bottoms leggings slacks chinos cargos ズボン パンツ"
    " ボトムス 裤 裤子 短裤 바지 하의 반바지 брюки штаны джинсы шорты pantalon pantalones vaqueros",
    "skirt": "skirt kilt miniskirt スカート 裙 裙子 半身裙 치마 스커트 юбка falda",
    "dress": "dress onepiece gown jumpsuit overall overalls romper kimono suit casualsuit elegantsuit sportsuit"
    " worksuit bodysuit uniform ワンピース ドレス 着物 制服 連身裙 连衣裙 旗袍 원피스 드레스 платье комбинезон vestido",
    "underwear": "underwear panties bra briefs boxers bikini swimsuit lingerie 下着 水着 内衣 泳衣 속옷 수영복 бельё"
    " белье трусы купальник",
    "gloves": "glove gloves gauntlet mitten mittens bracer 手袋 グローブ 手套 장갑 перчатки guantes",
    "shoes": "shoe shoes boot boots sneaker sneakers sandal sandals heel heels footwear slipper slippers sock socks"
    " stocking stockings 靴 ブーツ シューズ 靴下 鞋 鞋子 袜子 신발 구두 부츠 양말 обувь ботинки туфли сапоги носки"
    " zapatos zapato botas calcetines",
    "carried": "bag backpack rucksack satchel pouch holster belt sword axe knife dagger shield staff wand bow crossbow"
    " gun rifle pistol weapon quiver mug book spellbook throwable glasses spectacles goggles facewear earring necklace"
    " watch accessory accessories armor armour 武器 剣 盾 鞄 リュック 眼鏡 メガネ アクセサリー 剑 背包 书包 眼镜 가방"
    " 배낭 안경 검 방패 무기 рюкзак сумка очки меч щит оружие mochila bolso gafas espada escudo arma",
    DOLL: "mannequin mannequinf dummy doll surface joints 素体 マネキン 人台 마네킹 манекен maniqui",
    CLOTH: "cloth clothes clothing outfit costume garment apparel wear 服 衣装 衣服 服装 옷 의상 одежда ropa",
}
_KIND_OF = {word: kind for kind, words in WORDS.items() for word in words.split()}
_INSIDE = sorted((word for word in _KIND_OF if len(word) >= LONG or ord(word[0]) >= 0x3000), key=len)
_SPLIT = re.compile(r"[^\W\d_]+")
_CAPITALS = re.compile(r"(?<=[a-zа-яё])(?=[A-ZА-ЯЁ])|(?<=[A-Z])(?=[A-Z][a-z])")


def kind_of_names(names: Iterable[str | None]) -> str | None:
    """Returns the kind, a key of ``WORDS``, that a thing has by its ``names``; None where no name has a word of the
    table.

    The first name with such a word decides, so the most telling name comes first. In a name the last word decides: a
    ``hair_ribbon_bag`` is a bag. Words of ``GENERAL`` decide only where there is no other word.
    """
    general: str | None = None
    for name in names:
        kinds = [kind for word in _words(name or "") if (kind := _kind_of_word(word)) is not None]
        exact = [kind for kind in kinds if kind not in GENERAL]
        if exact:
            return exact[-1]
        general = general or (kinds[-1] if kinds else None)
    return general


def _words(name: str) -> list[str]:
    parts = _SPLIT.findall(_CAPITALS.sub(" ", name))
    whole = _SPLIT.findall(name)  # "tShirt" and "OnePiece" are words as a whole too.
    return [part.lower() for part in (*whole, *parts)]


def _kind_of_word(word: str) -> str | None:
    if word in _KIND_OF:
        return _KIND_OF[word]
    # The end of a compound says what it is: the longest word at the end, else the longest at the beginning.
    for fits in (word.endswith, word.startswith):
        found = [one for one in _INSIDE if fits(one)]
        if found:
            return _KIND_OF[found[-1]]
    return None
